#!/usr/bin/env bash
# Everything worth knowing of a GPU in one call: what it is, the time of each stage, and a training with its quality, with
# and without the gate.
#
#   scripts/measure_gpu.sh CAPTURE OUT [FRAMES]
#
# CAPTURE is Panoptic's basketball for figures that compare with docs/PERFORMANCE.md; FRAMES default to 0..3. TCGS names
# the program (default: tcgs on the PATH), DEVICE an adapter. OUT collects what each step printed and its JSON; a training
# that is there already goes on, so that a long one can be cut into several calls. SET has further arguments of both
# trainings, such as `--preset fast`. The whole in its smallest form, some minutes of software that acts as a GPU:
#
#   DEVICE=llvmpipe BENCH="--gaussians 2000 --size 64x48 --iterations 1" DOWNSCALE=8 \
#       SET="--set schedule.first_iterations=20 --set schedule.rest_iterations=10" scripts/measure_gpu.sh CAPTURE OUT 0..2
set -euo pipefail

capture=${1:?the folder of a capture}
out=${2:?a folder for results}
frames=${3:-0..3}
tcgs=${TCGS:-tcgs}
device=(--backend gpu)
[[ -z ${DEVICE:-} ]] || device=(--device "$DEVICE")
read -ra bench <<<"${BENCH:-}"
read -ra settings <<<"${SET:-}"
downscale=(--downscale "${DOWNSCALE:-1}")
mkdir -p "$out"

# Runs a step, and keeps going where one fails: the others are worth having.
step() {
    local name=$1
    shift
    echo "== $name: $*"
    local start=$SECONDS
    "$@" 2>&1 | tee "$out/$name.txt" || echo "== $name failed"
    echo "== $name: $((SECONDS - start)) s"
}

step bench "$tcgs" bench "${device[@]}" "${bench[@]}" --json "$out/bench.json" --force
step bench_capture "$tcgs" bench "${device[@]}" --capture "$capture" "${downscale[@]}" --json "$out/bench_capture.json" \
    --force
step train "$tcgs" train "$capture" --out "$out/run" --frames "$frames" --resume "${device[@]}" "${downscale[@]}" \
    "${settings[@]}" --json "$out/train.json" --force
# The same first timestep; later ones train everything.
step train_ungated "$tcgs" train "$capture" --out "$out/run_ungated" --frames "$frames" --resume "${device[@]}" \
    "${downscale[@]}" "${settings[@]}" --set gate.enabled=false --json "$out/train_ungated.json" --force
step eval_run "$tcgs" eval "$out/run" --capture "$capture" "${device[@]}" --json "$out/eval_run.json" --force
step compress "$tcgs" compress "$out/run" --out "$out/scene.tcgs" --json "$out/compress.json" --force
step eval_scene "$tcgs" eval "$out/scene.tcgs" --capture "$capture" "${device[@]}" --json "$out/eval_scene.json" --force

# A line a timestep of both trainings.
for run in run run_ungated; do
    echo "== $run"
    while read -r line; do
        grep -oE '"(timestep|active_gaussians|active_tiles|iterations|seconds|psnr)":[0-9.e-]+' <<<"$line" | paste -sd ' '
    done <"$out/$run/metrics.jsonl" || echo "== no metrics of $run"
done | tee "$out/gate.txt"
