"""One iteration of the solver against libigl's: libigl.py BENCH SCRATCH [CASE.npz ...]; see libigl.sh."""

import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import igl
import numpy as np

COUNT = 100  # iterations of one measurement
ROUNDS = 5  # of everything, in turn; medians are printed


def bar(cells, spacing=0.05):
    """A box of cubes in six tetrahedra each, whose far end is turned by 80 degrees."""
    shape = [c + 1 for c in cells]
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    number = lambda p: (p[..., 0] * shape[1] + p[..., 1]) * shape[2] + p[..., 2]
    corners = np.stack(np.meshgrid(*[np.arange(c) for c in cells], indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        path = [corners]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        tets.append(np.stack([number(p) for p in path], 1))
    rest = grid * spacing
    tets = np.concatenate(tets)
    return turned_end(rest, positive(rest, tets), axis=0, share=0.06)


def positive(rest, tets):
    """The same tetrahedra, all of positive volume."""
    a, b, c = (rest[tets[:, k]] - rest[tets[:, 3]] for k in range(3))
    flipped = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0
    tets = tets.copy()
    tets[flipped, :2] = tets[flipped, 1::-1]
    return tets


def turned_end(rest, tets, axis, share):
    """Both ends held, `share` of the length each, one of them turned."""
    low, high = rest.min(0), rest.max(0)
    along = (rest[:, axis] - low[axis]) / (high[axis] - low[axis])
    hard = np.flatnonzero((along <= share) | (along >= 1 - share))
    angle = np.radians(80) * (along[hard] > 0.5)
    centre = (low + high) / 2
    p, q = (axis + 1) % 3, (axis + 2) % 3
    targets = rest[hard].copy()
    d = rest[hard] - centre
    targets[:, p] = centre[p] + np.cos(angle) * d[:, p] - np.sin(angle) * d[:, q]
    targets[:, q] = centre[q] + np.sin(angle) * d[:, p] + np.cos(angle) * d[:, q]
    return {"V": rest, "T": tets, "hard": hard, "bc": targets}


def medit(path):
    """Vertices and tetrahedra of a MEDIT file; 40 vertices far from each other sway."""
    words = path.read_text().split()
    at = words.index("Vertices")
    count = int(words[at + 1])
    rest = np.array(words[at + 2 : at + 2 + 4 * count], float).reshape(-1, 4)[:, :3]
    at = words.index("Tetrahedra")
    count = int(words[at + 1])
    tets = np.array(words[at + 2 : at + 2 + 5 * count], int).reshape(-1, 5)[:, :4] - 1
    rest = rest / np.linalg.norm(np.ptp(rest, axis=0))
    hard, near = [], np.full(len(rest), np.inf)
    for _ in range(40):
        hard.append(int(np.argmax(near)) if hard else 0)
        near = np.minimum(near, np.linalg.norm(rest - rest[hard[-1]], axis=1))
    hard = np.array(hard)
    return {"V": rest, "T": positive(rest, tets), "hard": hard, "bc": rest[hard] + 0.03 * np.sin(9 * rest[hard])}


def stored(path):
    """A case as one that libigl can solve: each row of a soft handle becomes its heaviest vertex, held hard. The frame is that of the middle."""
    z = np.load(path)
    if "T" not in z or "frames" not in z or ("hard" not in z and "row_ptr" not in z):
        return None
    rest, frame = z["V"].astype(float), int(np.ravel(z["frames"])[0]) // 2
    held = {}
    if "row_ptr" in z:
        ptr, index, value = z["row_ptr"], z["row_idx"], z["row_val"]
        for h, target in enumerate(z["soft_targets"][frame].reshape(-1, 3)):
            terms = slice(ptr[h], ptr[h + 1])
            heaviest = index[terms][np.argmax(np.abs(value[terms]))]
            held[int(heaviest)] = rest[heaviest] + target - value[terms] @ rest[index[terms]]
    if "hard" in z:
        held |= dict(zip(z["hard"].tolist(), z["hard_targets"][frame].astype(float).reshape(-1, 3)))
    hard = np.array(sorted(held))
    return {"V": rest, "T": z["T"].astype(int), "hard": hard, "bc": np.array([held[v] for v in hard])}


class Peer:
    """libigl on a case."""

    def __init__(self, case):
        self.case = case
        self.data = igl.ARAPData()
        self.data.energy = igl.ARAP_ENERGY_TYPE_ELEMENTS
        self.data.max_iter = COUNT
        igl.arap_precomputation(case["V"], case["T"].astype(np.int64), 3, case["hard"].astype(np.int64), self.data)

    def run(self):
        """Pose after COUNT iterations from rest, and milliseconds of one on the cores of this process."""
        start = time.process_time()
        pose = igl.arap_solve(np.ascontiguousarray(self.case["bc"]), self.data, self.case["V"].copy())
        return np.asarray(pose), (time.process_time() - start) * 1e3 / COUNT


def main():
    bench, scratch, paths = sys.argv[1], Path(sys.argv[2]), [Path(p) for p in sys.argv[3:]]
    cases = {"bar 40x5x5": bar([40, 5, 5]), "bar 60x8x8": bar([60, 8, 8]), "scan's proxy": medit(scratch / "scan.mesh")}
    for path in paths:
        case = stored(path)
        if case is not None:
            cases[path.stem] = case
    files = {}
    for name, case in cases.items():
        files[name] = scratch / (name.replace(" ", "_").replace("'", "") + ".npz")
        # Frame 0 and a frame of the middle are the same: there is but one.
        np.savez(files[name], V=case["V"], T=case["T"], hard=case["hard"], hard_targets=case["bc"][None], frames=np.array([1]))
    peers = {name: Peer(case) for name, case in cases.items()}
    peer_ms, our_ms, poses = {n: [] for n in cases}, {n: [] for n in cases}, {}
    for turn in range(ROUNDS):
        for name in cases:
            poses[name], ms = peers[name].run()
            peer_ms[name].append(ms)
            command = [bench, "iteration", str(COUNT), str(files[name]), "--bench"]
            if turn == 0:
                command[3:3] = ["--poses", str(scratch)]
            line = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            our_ms[name].append([float(x) for x in line.split()[5:8]])

    print(f"libigl {version('libigl')} (ARAP, ELEMENTS), {COUNT} iterations from rest, one thread, milliseconds on the core per iteration, medians of {ROUNDS}")
    print("ratio: median of the ratios turn by turn. p99 to converged: of all vertices after the iterations, in diagonals")
    print()
    print("| case | vertices / tets / held | libigl | ours, AVX2 | ratio | ours, baseline | ratio | exact rotations | ratio | p99 to converged: libigl, ours |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, case in cases.items():
        them, us = np.array(peer_ms[name]), np.array(our_ms[name])
        ratio = np.median(them[:, None] / us, axis=0)
        ms = np.median(us, axis=0)
        read = lambda what: np.fromfile(scratch / f"{files[name].stem}.{what}").reshape(-1, 3)
        diagonal = np.linalg.norm(np.ptp(case["V"], axis=0))
        far = lambda pose: np.quantile(np.linalg.norm(pose - read("converged"), axis=1), 0.99) / diagonal
        print(
            f"| {name} | {len(case['V'])} / {len(case['T'])} / {len(case['hard'])} | {np.median(them):.2f} | {ms[0]:.3f} | **{ratio[0]:.1f}** "
            f"| {ms[1]:.3f} | **{ratio[1]:.1f}** | {ms[2]:.3f} | {ratio[2]:.1f} | {far(poses[name]):.1e}, {far(read('plain')):.1e} |"
        )
    if paths:
        print()
        print("with the cases' own handles, all frames solved to convergence:")
        for path in paths:
            if path.stem in cases:
                line = subprocess.run([bench, "iteration", str(COUNT), str(path), "--bench"], check=True, capture_output=True, text=True).stdout.split()
                print(f"  {path.stem}: {line[5]} ms per iteration; worst vertex {line[8]} diagonals from the stored poses")
    walk = next((p for p in paths if p.stem == "human_walk"), None)
    if walk:
        print()
        print(f"{walk.stem}: time to 0.1 mm")
        sys.stdout.flush()
        subprocess.run([bench, "walk", str(walk), f"{np.median(peer_ms[walk.stem]):.3f}", "--bench"], check=True)


if __name__ == "__main__":
    main()
