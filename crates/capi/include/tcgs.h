// Reads .tcgs scenes: moving 3D Gaussians, compressed. Made by cbindgen of crates/capi; do not edit.
//
// Open a scene from a file, from bytes, or from a function that reads ranges of bytes. Then read timesteps into your
// own arrays. Timesteps are decoded a segment at a time, and the decoded segment stays in memory for the next calls.
//
// Every function that can fail returns a TcgsStatus. tcgs_last_error() then gives one line: the fault, and the expected
// value. Damaged and hostile files are refused: no file causes access outside its arrays, and memory is bounded. A
// scene may move between threads, but only one thread at a time may use it. Scenes are independent of each other.

#pragma once

#include <stddef.h>
#include <stdint.h>

// Result of a call.
typedef enum TcgsStatus {
  // Success.
  TCGS_STATUS_OK = 0,
  // An argument is wrong: NULL, a timestep that does not exist, arrays too short.
  TCGS_STATUS_ARGUMENT = 1,
  // The file cannot be read. Trying again may help.
  TCGS_STATUS_IO = 2,
  // The file is damaged, or is not a .tcgs file.
  TCGS_STATUS_FORMAT = 3,
  // The file has a version that this library does not know. A newer library may read it.
  TCGS_STATUS_VERSION = 4,
  // The file asks for more memory than a scene of its length could need.
  TCGS_STATUS_LIMIT = 5,
  // A defect of this library. Please report it.
  TCGS_STATUS_DEFECT = 6,
} TcgsStatus;

// An open scene.
typedef struct TcgsScene TcgsScene;

// Copies a part of the file into a buffer.
//
// - `user`: as given to `tcgs_open_reader`
// - `offset`, `length`: bytes of the file, always within its size
// - `buffer`: room for `length` bytes
// - returns: 0, or any other number if the bytes cannot be read; the call then fails with TCGS_STATUS_IO
typedef int32_t (*TcgsReadFunction)(void *user, uint64_t offset, uint8_t *buffer, size_t length);

// The properties of a scene, as `tcgs_scene_info` returns them.
typedef struct TcgsSceneInfo {
  // Timesteps, counted from 0.
  uint32_t num_timesteps;
  // No timestep has more Gaussians: arrays of this length hold every timestep.
  uint32_t max_gaussians;
  // Timesteps per second; 0 if the file does not say.
  float frame_rate;
  // Degree of the spherical harmonics, 0 to 3. At 0 a colour is the same from every direction.
  uint32_t sh_degree;
  // 1 if splats are antialiased, else 0. A renderer of antialiased splats compensates the opacity: 3D Gaussian
  // splatting widens a splat by a pixel's extent, and the opacity is multiplied by sqrt(det(covariance before) /
  // det(covariance after)).
  uint32_t antialiased;
  // World axis that points up: 0 unknown, 1 to 6 for x, y, z, -x, -y, -z. Axes are right-handed.
  uint32_t up;
  // Smallest coordinates of all centres at all timesteps, scene units.
  float bounds_min[3];
  // Largest coordinates of all centres at all timesteps, scene units.
  float bounds_max[3];
  // Colour behind all Gaussians: red, green and blue, sRGB in [0, 1]. The Gaussians are to be drawn on it.
  float background[3];
} TcgsSceneInfo;

// The caller's arrays for the Gaussians of one timestep, each of `capacity` rows. NULL for an array that is not
// wanted.
typedef struct TcgsArrays {
  // Number of rows that each array has room for; `max_gaussians` is enough for every timestep.
  size_t capacity;
  // `[capacity, 3]` centres, scene units.
  float *means;
  // `[capacity, 4]` unit rotations: w, x, y, z.
  float *quats;
  // `[capacity, 3]` standard deviations along the axes, scene units.
  float *scales;
  // `[capacity]` opacities, 0 to 1.
  float *opacities;
  // `[capacity, 3]` colours: red, green, blue; with harmonics, the part that does not depend on the direction.
  float *colors;
  // `[capacity, (sh_degree + 1)^2 - 1, 3]` coefficients of the harmonics from degree 1 on, in the order of 3D
  // Gaussian splatting; unused where `sh_degree` is 0.
  float *harmonics;
} TcgsArrays;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens a scene from a file. Close it with `tcgs_close`.
//
// - `path`: UTF-8, ends with a zero byte
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

// Opens a scene whose bytes a function reads range by range, when they are needed: from an archive, or over a network.
// Close it with `tcgs_close`.
//
// - `read`: called by this function and by `tcgs_read`, on their thread
// - `user`: passed to `read`
// - `size`: length of the file, bytes
// - `scene`: receives the scene; NULL if this fails
//
// # Safety
// `read` fulfils its contract, with `user`, until the scene is closed; `scene` points to a pointer.
enum TcgsStatus tcgs_open_reader(TcgsReadFunction read, void *user, uint64_t size, struct TcgsScene **scene);

// Closes a scene; NULL is ignored.
//
// # Safety
// `scene` comes from an open function, and is not used again.
void tcgs_close(struct TcgsScene *scene);

// Returns the properties of a scene.
//
// # Safety
// `scene` is open, and `info` points to a `TcgsSceneInfo`.
enum TcgsStatus tcgs_scene_info(const struct TcgsScene *scene, struct TcgsSceneInfo *info);

// Name of the scene's capture: UTF-8 that ends with a zero byte and lives until the scene is closed. Empty if the file
// has no name, NULL if `scene` is NULL.
//
// # Safety
// `scene` is open, or NULL.
const char *tcgs_scene_name(const struct TcgsScene *scene);

// Reads the Gaussians that live at a timestep, ready to be drawn. Successive calls are fastest for successive
// timesteps.
//
// - `timestep`: below `num_timesteps`
// - `arrays`: filled from their first row on; untouched if this fails
// - `num_gaussians`: receives the number of Gaussians that live at this timestep
//
// # Safety
// `scene` is open; arrays that are not NULL have room for `capacity` rows; `num_gaussians` points to a number.
enum TcgsStatus tcgs_read(struct TcgsScene *scene,
                          uint32_t timestep,
                          const struct TcgsArrays *arrays,
                          size_t *num_gaussians);

// Why the last failed call of this thread failed: one line of UTF-8 that ends with a zero byte. It lives until the
// next call of this thread fails, and is empty if no call has failed.
const char *tcgs_last_error(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus
