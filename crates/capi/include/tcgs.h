// Reads .tcgs scenes: moving 3D Gaussians, compressed. Made by cbindgen of crates/capi; do not edit.
//
// Open a scene from a file, from bytes, or from a function that reads ranges of bytes; then read timesteps into arrays of
// your own. A timestep is decoded with the others of its segment when one of them is first asked for, and the segment stays
// in memory for the next ones.
//
// Every function that can fail returns a TcgsStatus; tcgs_last_error() then has one line that says what was found and what
// was expected. Damaged and hostile files are refused: none leads outside of its arrays, and memory is bounded.
// A scene may move between threads, and is used by one at a time. Scenes do not know of each other.

#pragma once

#include <stddef.h>
#include <stdint.h>

// How a call ended.
typedef enum TcgsStatus {
  // Well.
  TCGS_STATUS_OK = 0,
  // An argument is wrong: NULL, a timestep that there is not, arrays too short.
  TCGS_STATUS_ARGUMENT = 1,
  // The file cannot be read. Trying again may help.
  TCGS_STATUS_IO = 2,
  // The file is damaged, or no .tcgs file.
  TCGS_STATUS_FORMAT = 3,
  // The file is of a version that this library does not know. A newer one may read it.
  TCGS_STATUS_VERSION = 4,
  // The file asks for more memory than a scene of its length could need.
  TCGS_STATUS_LIMIT = 5,
  // A defect of this library. Please report it.
  TCGS_STATUS_DEFECT = 6,
} TcgsStatus;

// An open scene.
typedef struct TcgsScene TcgsScene;

// Fills a part of the file into a buffer.
//
// - `user`: as given to `tcgs_open_reader`
// - `offset`, `length`: bytes of the file, always within its size
// - `buffer`: room for `length` bytes
// - returns: 0, or any other number if the bytes cannot be had, which is told as TCGS_STATUS_IO
typedef int32_t (*TcgsReadFunction)(void *user, uint64_t offset, uint8_t *buffer, size_t length);

// What a scene is, as `tcgs_scene_info` tells.
typedef struct TcgsSceneInfo {
  // Timesteps, counted from 0.
  uint32_t num_timesteps;
  // Most Gaussians that live at one timestep: arrays of so many hold every timestep.
  uint32_t max_gaussians;
  // Timesteps per second; 0 if the file does not say.
  float frame_rate;
  // Degree of the spherical harmonics, 0 to 3; 0: a colour is the same from everywhere.
  uint32_t sh_degree;
  // 1 if splats are antialiased: a renderer that widens a splat by a pixel's extent, as 3D Gaussian splatting does, multiplies
  // its opacity by the root of the quotient of the determinants of its covariance before and after. Else 0.
  uint32_t antialiased;
  // World axis that points up: 0 unknown, 1 to 6 for x, y, z, -x, -y, -z. Axes are right-handed.
  uint32_t up;
  // Smallest coordinates of all centres at all timesteps, scene units.
  float bounds_min[3];
  // Largest coordinates.
  float bounds_max[3];
} TcgsSceneInfo;

// Arrays of the caller for the Gaussians of one timestep, each of `capacity` rows; NULL for what is not wanted.
typedef struct TcgsArrays {
  // Rows that each array has room for; `max_gaussians` is enough for every timestep.
  size_t capacity;
  // `[capacity, 3]` centres, scene units.
  float *means;
  // `[capacity, 4]` unit rotations: w, x, y, z.
  float *quats;
  // `[capacity, 3]` standard deviations along the axes, scene units.
  float *scales;
  // `[capacity]` opacities, 0 to 1.
  float *opacities;
  // `[capacity, 3]` colours: red, green, blue; of harmonics what does not depend on the direction.
  float *colors;
  // `[capacity, (sh_degree + 1)^2 - 1, 3]` coefficients of the harmonics from degree 1 on, in the order of 3D Gaussian
  // splatting; unused where `sh_degree` is 0.
  float *harmonics;
} TcgsArrays;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens a scene from a file. Close it with `tcgs_close`.
//
// - `path`: ends with a zero byte; UTF-8
// - `scene`: receives the scene; NULL if this fails
//
// # Safety
// `path` points to a text that ends with a zero byte, and `scene` to a pointer.
enum TcgsStatus tcgs_open_file(const char *path, struct TcgsScene **scene);

// Opens a scene from the bytes of a file, which are copied. Close it with `tcgs_close`.
//
// - `bytes`, `length`: the whole file
// - `scene`: receives the scene; NULL if this fails
//
// # Safety
// `bytes` points to `length` bytes, and `scene` to a pointer.
enum TcgsStatus tcgs_open_bytes(const uint8_t *bytes, size_t length, struct TcgsScene **scene);

// Opens a scene whose bytes a function reads, range by range, when they are needed: from an archive, or over a network.
// Close it with `tcgs_close`.
//
// - `read`: is called by this function and by `tcgs_read`, on their thread
// - `user`: is handed to `read`
// - `size`: bytes of the file
// - `scene`: receives the scene; NULL if this fails
//
// # Safety
// `read` keeps to its description, with `user`, until the scene is closed; `scene` points to a pointer.
enum TcgsStatus tcgs_open_reader(TcgsReadFunction read, void *user, uint64_t size, struct TcgsScene **scene);

// Closes a scene; NULL is none.
//
// # Safety
// `scene` is of an open function, and is not used again.
void tcgs_close(struct TcgsScene *scene);

// Tells what a scene is.
//
// # Safety
// `scene` is open, and `info` points to a `TcgsSceneInfo`.
enum TcgsStatus tcgs_scene_info(const struct TcgsScene *scene, struct TcgsSceneInfo *info);

// Name of the capture that a scene is of: UTF-8 that ends with a zero byte and lives until the scene is closed; empty if the
// file has none, NULL if `scene` is.
//
// # Safety
// `scene` is open, or NULL.
const char *tcgs_scene_name(const struct TcgsScene *scene);

// Reads the Gaussians that live at a timestep, ready to be drawn. Fastest if successive calls ask for successive timesteps.
//
// - `timestep`: below `num_timesteps`
// - `arrays`: which are filled from their first row on; untouched if this fails
// - `num_gaussians`: receives how many live at this timestep
//
// # Safety
// `scene` is open; arrays that are not NULL have room for `capacity` rows; `num_gaussians` points to a number.
enum TcgsStatus tcgs_read(struct TcgsScene *scene,
                          uint32_t timestep,
                          const struct TcgsArrays *arrays,
                          size_t *num_gaussians);

// What went wrong in the last call of this thread that returned no TCGS_STATUS_OK: one line of UTF-8 that ends with a zero
// byte and lives until such a call; empty if there was none.
const char *tcgs_last_error(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus
