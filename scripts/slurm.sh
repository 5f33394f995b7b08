#!/usr/bin/env bash
# Runs a job array on a Slurm of one node: twelve takes, of which one task is killed and the node's daemon too, then compares every byte with the
# same manifest run by `retarget batch`. Minutes.
#
#   scripts/slurm.sh          as root on Debian; installs slurmctld, slurmd, slurm-client and munge where they are missing
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
[ "$(id -u)" = 0 ] || { echo "needs root: Slurm's daemons start tasks as other users" >&2; exit 1; }
if ! (command -v slurmctld && command -v slurmd && command -v sbatch && command -v munged && command -v bc) >/dev/null; then
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq slurmctld slurmd slurm-client munge bc >/dev/null
fi
cargo build --release
export RETARGET=${CARGO_TARGET_DIR:-$root/target}/release/retarget

work=$(mktemp -d "${TMPDIR:-/tmp}/retarget-slurm.XXXXXX")
export SLURM_CONF=$work/slurm.conf
stop() {
  for daemon in slurmctld slurmd; do [ -f "$work/$daemon.pid" ] && kill "$(cat "$work/$daemon.pid")" 2>/dev/null || true; done
  [ -f "$work/munged.pid" ] && kill "$(cat "$work/munged.pid")" 2>/dev/null || true
  sleep 1
  rm -rf "$work"
}
trap stop EXIT

# --- one node ---------------------------------------------------------------------------------------------------------------------------
mkdir -p "$work/state" "$work/spool" "$work/munge"
chmod 755 "$work"
dd if=/dev/urandom of="$work/munge/key" bs=1024 count=1 status=none
chown -R munge "$work/munge" 2>/dev/null || true
chmod 700 "$work/munge" && chmod 400 "$work/munge/key"
chown root "$work/munge" "$work/munge/key"
munged --force --key-file "$work/munge/key" --socket "$work/munge.socket" --pid-file "$work/munged.pid" --log-file "$work/munged.log" --seed-file "$work/munge.seed"
cores=$(nproc)
host=$(hostname -s)
cat >"$SLURM_CONF" <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge.socket
CryptoType=crypto/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SchedulerType=sched/backfill
SchedulerParameters=bf_interval=2,sched_interval=2,requeue_delay=1
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPort=17817
SlurmdPort=17818
SlurmdTimeout=10
SlurmctldTimeout=10
ReturnToService=2
KillWait=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cores State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
slurmctld -f "$SLURM_CONF"
slurmd -f "$SLURM_CONF"
for _ in $(seq 60); do [ "$(sinfo -h -o %t 2>/dev/null)" = idle ] && break; sleep 1; done
echo "node: $(sinfo -h -o '%n %t, %c cores')"

# --- twelve takes -----------------------------------------------------------------------------------------------------------------------
manifest() {
  mkdir -p "$1"
  cp fixtures/scan.obj fixtures/scan.mtl fixtures/scan_skin.png fixtures/walk.c3d "$1"
  {
    echo 'scan,capture,out,frames'
    for n in $(seq 12); do echo "scan.obj,walk.c3d,out/$n.glb|out/$n.pc2,$((n * 20))..$((n * 20 + 130))"; done
  } >"$1/list.csv"
}
manifest "$work/slurm"
manifest "$work/local"
"$RETARGET" batch --estimate "$work/slurm/list.csv" 2>&1 | tail -n 1

began=$(date +%s.%N)
job=$(sbatch --parsable --array=1-12 --cpus-per-task=1 --time=0:10:00 --output="$work/%a.log" farm/retarget.sbatch "$work/slurm/list.csv")
done_takes() { grep -l '"state": "done"' "$work"/slurm/out/*.take.json 2>/dev/null | wc -l; }
until [ "$(done_takes)" -ge 2 ]; do sleep 0.2; done
# Between two tasks there is none.
until victim=$(pgrep -f "batch $work/slurm/list.csv --index" | head -n 1) && [ -n "$victim" ]; do sleep 0.05; done
killed=$(tr '\0' ' ' <"/proc/$victim/cmdline" | sed 's/.*--index \([0-9]*\).*/\1/')
kill -9 "$victim"
echo "killed: the process of take $killed after $(done_takes) takes"
until [ "$(done_takes)" -ge 5 ]; do sleep 0.2; done
echo "killed: the node's daemon and its tasks after $(done_takes) takes"
kill -9 "$(cat "$work/slurmd.pid")"
pkill -9 -f "slurmstepd: \\[$job" || true
pkill -9 -f "batch $work/slurm/list.csv --index" || true
sleep 3
slurmd -f "$SLURM_CONF"
# A task that failed, unlike one that lost its node, waits to be asked for again.
for _ in $(seq 40); do squeue -h -t all -j "${job}_$killed" -o %t 2>/dev/null | grep -qE '^(F|NF|CA|TO)$' && break; sleep 0.5; done
scontrol requeue "${job}_$killed" 2>/dev/null || true
for _ in $(seq 600); do
  [ "$(done_takes)" -ge 12 ] && break
  # Nothing waits and not all is done: tasks that the daemon took along without a word are asked for again.
  if [ -z "$(squeue -h -j "$job" 2>/dev/null)" ]; then
    job=$(sbatch --parsable --array=1-12 --cpus-per-task=1 --time=0:10:00 --output="$work/%a.log" farm/retarget.sbatch "$work/slurm/list.csv")
    echo "asked again: the whole array, of which $(done_takes) are done"
  fi
  sleep 1
done
wall=$(echo "$(date +%s.%N) - $began" | bc)

# --- against the local run --------------------------------------------------------------------------------------------------------------
began=$(date +%s.%N)
"$RETARGET" batch "$work/local/list.csv" 2>&1 | tail -n 14
local_wall=$(echo "$(date +%s.%N) - $began" | bc)
same=0
for n in $(seq 12); do
  for kind in glb pc2; do cmp "$work/slurm/out/$n.$kind" "$work/local/out/$n.$kind" && same=$((same + 1)); done
done
echo "slurm: $(done_takes) of 12 takes done in ${wall} s, with two failures on the way; locally ${local_wall} s; $same of 24 outputs are the same bytes"
[ "$same" = 24 ]
