/* A scene from a file, from bytes and through a function that reads ranges gives the same arrays, all of them, at every
   timestep; arrays that are too short are left alone, and a function that fails is told as what it is. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tcgs.h"

#define CHECK(what) \
  if (!(what)) return fprintf(stderr, "%s: not so: %s (%s)\n", path, #what, tcgs_last_error()), EXIT_FAILURE

typedef struct {
  uint8_t *bytes;
  size_t size;
  int fails;
} Source;

static int32_t read_range(void *user, uint64_t offset, uint8_t *buffer, size_t length) {
  Source *source = user;
  if (source->fails || offset > source->size || length > source->size - offset) return 7;
  memcpy(buffer, source->bytes + offset, length);
  return 0;
}

/* Columns of `rows` rows one after the other in one block of exactly that size. */
static TcgsArrays columns(float *block, size_t rows, size_t harmonics) {
  TcgsArrays arrays = {rows, block, block + 3 * rows, block + 7 * rows, block + 10 * rows, block + 11 * rows, NULL};
  if (harmonics > 0) arrays.harmonics = block + 14 * rows;
  return arrays;
}

int main(int argc, char **argv) {
  const char *path = argc == 2 ? argv[1] : "usage: ways SCENE.tcgs";
  CHECK(argc == 2);
  FILE *file = fopen(path, "rb");
  CHECK(file && fseek(file, 0, SEEK_END) == 0);
  Source source = {NULL, (size_t)ftell(file), 0};
  rewind(file);
  source.bytes = malloc(source.size);
  CHECK(source.bytes && fread(source.bytes, 1, source.size, file) == source.size);
  fclose(file);

  TcgsScene *scenes[3];
  CHECK(tcgs_open_file(path, &scenes[0]) == TCGS_STATUS_OK);
  CHECK(tcgs_open_bytes(source.bytes, source.size, &scenes[1]) == TCGS_STATUS_OK);
  CHECK(tcgs_open_reader(read_range, &source, source.size, &scenes[2]) == TCGS_STATUS_OK);
  TcgsSceneInfo info;
  CHECK(tcgs_scene_info(scenes[0], &info) == TCGS_STATUS_OK);
  size_t rows = info.max_gaussians, harmonics = (size_t)(info.sh_degree + 1) * (info.sh_degree + 1) - 1;
  size_t block = rows * (14 + 3 * harmonics) * sizeof(float);
  float *blocks[3];
  for (int i = 0; i < 3; i++) CHECK((blocks[i] = malloc(block + 1)) != NULL);
  for (uint32_t t = 0; t < info.num_timesteps; t++) {
    size_t counts[3];
    for (int i = 0; i < 3; i++) {
      memset(blocks[i], 0, block);
      TcgsArrays arrays = columns(blocks[i], rows, harmonics);
      CHECK(tcgs_read(scenes[i], t, &arrays, &counts[i]) == TCGS_STATUS_OK);
      CHECK(counts[i] == counts[0] && memcmp(blocks[i], blocks[0], block) == 0);
    }
    if (counts[0] > 0) {
      TcgsArrays short_by_one = columns(blocks[1], counts[0] - 1, 0);
      CHECK(tcgs_read(scenes[1], t, &short_by_one, &counts[1]) == TCGS_STATUS_ARGUMENT);
      CHECK(memcmp(blocks[1], blocks[0], block) == 0);
    }
  }
  TcgsArrays arrays = columns(blocks[0], rows, harmonics);
  size_t count;
  CHECK(tcgs_read(scenes[0], info.num_timesteps, &arrays, &count) == TCGS_STATUS_ARGUMENT);
  TcgsScene *none;
  source.fails = 1;
  CHECK(tcgs_open_reader(read_range, &source, source.size, &none) == TCGS_STATUS_IO && none == NULL);
  CHECK(tcgs_open_bytes(source.bytes, source.size / 2, &none) == TCGS_STATUS_FORMAT && none == NULL);

  for (int i = 0; i < 3; i++) {
    tcgs_close(scenes[i]);
    free(blocks[i]);
  }
  free(source.bytes);
  return EXIT_SUCCESS;
}
