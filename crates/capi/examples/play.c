/* Reads a .tcgs scene timestep by timestep, as an engine would before it draws:

     cargo build --release -p tcgs-capi
     cc -I crates/capi/include crates/capi/examples/play.c target/release/libtcgs_c.a -lpthread -ldl -lm -o play
     ./play scene.tcgs

   Windows and macOS need other libraries after libtcgs_c.a; this command lists them:
   cargo rustc -p tcgs-capi -- --print native-static-libs */
#include <stdio.h>
#include <stdlib.h>

#include "tcgs.h"

static int failed(const char *what) {
  fprintf(stderr, "%s: %s\n", what, tcgs_last_error());
  return EXIT_FAILURE;
}

int main(int argc, char **argv) {
  if (argc != 2) {
    fprintf(stderr, "usage: play SCENE.tcgs\n");
    return EXIT_FAILURE;
  }
  TcgsScene *scene;
  if (tcgs_open_file(argv[1], &scene) != TCGS_STATUS_OK) return failed(argv[1]);
  TcgsSceneInfo info;
  if (tcgs_scene_info(scene, &info) != TCGS_STATUS_OK) return failed(argv[1]);
  printf("%s: %u timesteps of up to %u Gaussians, %g a second, harmonics of degree %u\n", tcgs_scene_name(scene),
         info.num_timesteps, info.max_gaussians, info.frame_rate, info.sh_degree);

  /* One set of arrays for all timesteps. Scales and harmonics are left out here. */
  size_t n = info.max_gaussians;
  TcgsArrays arrays = {n, malloc(n * 3 * sizeof(float)), malloc(n * 4 * sizeof(float)), NULL,
                       malloc(n * sizeof(float)), malloc(n * 3 * sizeof(float)), NULL};
  if (n > 0 && !(arrays.means && arrays.quats && arrays.opacities && arrays.colors)) return EXIT_FAILURE;
  int result = EXIT_SUCCESS;
  for (uint32_t t = 0; t < info.num_timesteps; t++) {
    size_t count;
    if (tcgs_read(scene, t, &arrays, &count) != TCGS_STATUS_OK) {
      result = failed(argv[1]);
      break;
    }
    /* Here an engine would upload the arrays. */
    double center[3] = {0}, weight = 1e-30;
    for (size_t i = 0; i < count; i++) {
      for (int c = 0; c < 3; c++) center[c] += arrays.opacities[i] * arrays.means[3 * i + c];
      weight += arrays.opacities[i];
    }
    printf("timestep %u: %zu Gaussians around %.3f %.3f %.3f\n", t, count, center[0] / weight, center[1] / weight,
           center[2] / weight);
  }
  free(arrays.means);
  free(arrays.quats);
  free(arrays.opacities);
  free(arrays.colors);
  tcgs_close(scene);
  return result;
}
