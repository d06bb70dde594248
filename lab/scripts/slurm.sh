#!/usr/bin/env bash
#SBATCH --job-name=tcgs-lab
#SBATCH --gpus=1
# One task of an array runs one line of a file of commands:
#   cargo run --release -p tcgs-lab -- ablation --data CAPTURES --out OUT --print-commands > commands.txt
#   sbatch --array=1-$(wc -l < commands.txt) lab/scripts/slurm.sh commands.txt
set -euo pipefail
if (($# != 1)) || [[ ! -r $1 ]]; then
    echo "${1:-commands}: not a file that can be read, expected the commands that --print-commands prints" >&2
    exit 2
fi
command=$(sed -n "${SLURM_ARRAY_TASK_ID:?is set by sbatch --array}p" "$1")
if [[ -z $command ]]; then
    echo "$1: has no line $SLURM_ARRAY_TASK_ID, expected --array=1-$(wc -l <"$1")" >&2
    exit 2
fi
exec bash -c "$command"
