#!/usr/bin/env bash
# A study as a Slurm array, one slice a task. The slices meet in a shared folder; the last line joins them.
#
#   sbatch --array=1-64 sim-hil/cluster/slurm.sh mobility --seeds 256
#   sbatch --array=1-64 sim-hil/cluster/slurm.sh sensitivity mass --seeds 64 --model calibrated
#
# A task that was killed goes on where it ended when it is submitted again (SLICES=64 sbatch --array=7,9 ...).
# When all are done:
#
#   flix-sim study merge out/study/array/results-*.parquet
#
#SBATCH --job-name=flix-study
#SBATCH --cpus-per-task=4
#SBATCH --time=02:00:00
#SBATCH --requeue
set -euo pipefail
PROGRAM=${PROGRAM:-flix-sim}
FOLDER=${FOLDER:-out/study/array}
SLICES=${SLICES:-${SLURM_ARRAY_TASK_COUNT:?run this with sbatch --array=1-N}}
export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-4}
exec "$PROGRAM" study "$@" --out "$FOLDER" --shard "$SLURM_ARRAY_TASK_ID/$SLICES"
