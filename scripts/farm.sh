#!/usr/bin/env bash
# What a take costs: seconds, memory and bytes by scan, length and output; the set-up with and without --cache; takes side by side. Prints the
# tables of docs/farm.md; minutes.
#
#   scripts/farm.sh          first: cargo build --release
#
# Needs python3. Real scans and takes where RETARGET_SHARED names their folder (else ../shared), else the fixture's alone.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "${PROGRAM:-target/release/retarget}")
shared=$(realpath -m "${RETARGET_SHARED:-../shared}")
scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-farm.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
cp fixtures/scan.obj fixtures/scan.mtl fixtures/scan_skin.png fixtures/walk.c3d "$scratch"
PROGRAM=$program SHARED=$shared python3 - "$scratch" <<'PYTHON'
import json, os, shutil, subprocess, sys, time
from pathlib import Path

program, shared, scratch = os.environ["PROGRAM"], Path(os.environ["SHARED"]) / "data", Path(sys.argv[1])
scans = {"fixture": (scratch / "scan.obj", scratch / "walk.c3d", "")}
if shared.is_dir():
    bodies, c3d = shared / "meshes", shared / "motion/c3d"
    scans["game body"] = (bodies / "bodies/makehuman_male_body_tpose_quads_cm.obj.gz", c3d / "mocap36.c3d", "")
    scans["dense scan"] = (bodies / "scans/synthetic_scan_male_apose_mm_zup.ply.gz", c3d / "pig_antom_walk.c3d", c3d / "pig_antom_static.c3d")
else:
    print("real data: not here, the fixture's takes alone\n")


def batch(rows, *options):
    """Runs takes (scan, capture, reference, output, frames) and gives their records and the seconds that all took."""
    folder = scratch / "batch"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    lines = ["scan,capture,ref-file,out,frames"]
    lines += [",".join(map(str, (*row[:3], f"out/{n}{row[3]}", row[4]))) for n, row in enumerate(rows)]
    (folder / "list.csv").write_text("\n".join(lines) + "\n")
    began = time.monotonic()
    ended = subprocess.run([program, "batch", folder / "list.csv", *map(str, options)], capture_output=True, text=True)
    seconds = time.monotonic() - began
    if ended.returncode:
        sys.exit(f"{ended.stderr}")
    records = [json.loads((folder / f"out/{n}{row[3]}.take.json").read_text()) for n, row in enumerate(rows)]
    return records, seconds


def middle(values):
    return sorted(values)[len(values) // 2]


print("| scan | vertices | output | frames | seconds | of these set-up | ms a frame | MB read | MB written | peak MB |\n|---|---|---|---|---|---|---|---|---|---|")
for name, (scan, capture, reference) in scans.items():
    for ending in (".glb", ".pc2", ".abc"):
        runs = [batch([(scan, capture, reference, ending, "")], "--workers", 1) for _ in range(3)]
        record = runs[0][0][0]
        of = lambda key: middle([records[0]["summary"][key] for records, _ in runs])
        read = sum(Path(scratch / "batch" / path).stat().st_size for path in record["inputs"]) / 1e6
        written = sum(record["outputs"].values()) / 1e6
        frames, seconds, setup = record["summary"]["frames"], of("seconds"), of("setup_seconds")
        print(f"| {name} | {record['summary']['vertices']:,} | `{ending}` | {frames:,} | {seconds:.1f} | {setup:.2f} | "
              f"{1e3 * (seconds - setup) / frames:.1f} | {read:.1f} | {written:.1f} | {of('peak_mb'):.0f} |", flush=True)

print("\n| scan | without a cache: set-up s, share of the take as `.pc2` (dense scan: 100 frames) | first take with one | further takes | entries MB | same bytes |\n|---|---|---|---|---|---|")
for name, (scan, capture, reference) in scans.items():
    row, cache = [(scan, capture, reference, ".pc2", "143..242" if name == "dense scan" else "")], scratch / "cache"
    columns, outputs = [], set()
    for _ in range(3):
        shutil.rmtree(cache, ignore_errors=True)
        for kind, options in enumerate([(), ("--cache", cache), ("--cache", cache)]):
            (record,), _ = batch(row, "--workers", 1, *options)
            columns.append((kind, record["summary"]["setup_seconds"], record["summary"]["seconds"]))
            outputs.add((scratch / "batch/out/0.pc2").read_bytes())
    size = sum(entry.stat().st_size for entry in cache.iterdir()) / 1e6
    cells = []
    for kind in range(3):
        setup, whole = (middle([column[at] for column in columns if column[0] == kind]) for at in (1, 2))
        cells.append(f"{setup:.2f} s, {100 * setup / whole:.0f} %")
    print(f"| {name} | {' | '.join(cells)} | {size:.1f} | {'yes' if len(outputs) == 1 else 'NO'} |", flush=True)

cores = os.cpu_count()
print(f"\n12 takes of {list(scans)[-1]}, `.pc2`, {cores} cores:\n\n| workers | seconds | takes an hour |\n|---|---|---|")
scan, capture, reference = list(scans.values())[-1]
for workers in sorted({1, cores}):
    _, seconds = batch([(scan, capture, reference, ".pc2", "")] * 12, "--workers", workers)
    print(f"| {workers} | {seconds:.1f} | {12 * 3600 / seconds:,.0f} |", flush=True)
PYTHON
