"""Writes a thing made of three rigid parts, parts.obj, and how each of them is moved, parts.csv: a stand, and two arms that turn on it.

    parts.py FOLDER
"""
import math
import os
import sys

GRID = 6


def box(centre, size):
    """Vertices and quads of a box, each side a grid of its own."""
    vertices, faces = [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            first = len(vertices)
            for a in range(GRID + 1):
                for b in range(GRID + 1):
                    p = [0.0, 0.0, 0.0]
                    p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3] = side, a / GRID - 0.5, b / GRID - 0.5
                    vertices.append([c + s * x for c, s, x in zip(centre, size, p)])
            for a in range(GRID):
                for b in range(GRID):
                    quad = [first + a * (GRID + 1) + b, first + (a + 1) * (GRID + 1) + b]
                    quad = quad + [quad[1] + 1, quad[0] + 1]
                    faces.append(quad if side > 0 else quad[::-1])
    places = {}
    number = [places.setdefault(tuple(round(x, 9) for x in v), len(places)) for v in vertices]
    return list(places), [[number[v] for v in face] for face in faces]


def main(folder):
    parts = {"stand": ((0, 0.2, 0), (0.6, 0.4, 0.6)), "left": ((-0.5, 0.6, 0), (0.9, 0.15, 0.15)), "right": ((0.55, 0.9, 0), (0.9, 0.2, 0.2))}
    with open(os.path.join(folder, "parts.obj"), "w") as out:
        first = 1
        for name, (centre, size) in parts.items():
            vertices, faces = box(centre, size)
            print(f"o {name}", *("v {} {} {}".format(*v) for v in vertices), sep="\n", file=out)
            print(*("f " + " ".join(str(v + first) for v in face) for face in faces), sep="\n", file=out)
            first += len(vertices)
    with open(os.path.join(folder, "parts.csv"), "w") as out:
        print("frame,name,x,y,z,qx,qy,qz,qw", file=out)
        for frame in range(60):
            for (name, (centre, _)), speed in zip(parts.items(), (0.0, 0.04, -0.06)):
                half = 0.5 * speed * frame
                print(frame, name, *centre, 0, math.sin(half), 0, math.cos(half), sep=",", file=out)


if __name__ == "__main__":
    main(sys.argv[1])
