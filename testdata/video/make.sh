#!/usr/bin/env bash
# Makes the videos of this folder with ffmpeg 5.1 (libx264, libx265). Every frame is grey and says by its brightness
# which it is: 40 + 15 times its number, and half a step more a column.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
grey="color=s=64x48:r=25:d=0.48,format=yuv420p,geq=lum='40+15*N+X/2':cb=128:cr=128"
make() { ffmpeg -v error -y -f lavfi -i "$grey" -map_metadata -1 -fflags +bitexact -flags:v +bitexact "$@"; }
# 12 frames that refer to later ones; decoding may begin at 0, 5 and 10.
make -c:v libx264 -crf 4 -g 5 -bf 3 -x264-params b-adapt=0:scenecut=0 frames.mp4
make -frames:v 1 -c:v libx265 -x265-params log-level=none hevc.mp4
make -frames:v 2 -c:v libx264 -pix_fmt yuv422p halves.mp4
