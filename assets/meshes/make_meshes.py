"""Simulates the built-in cloth shapes: drape.ply (a square cloth over a ball on a plinth) and curtain.ply.

Run by people: `python3 assets/meshes/make_meshes.py [drape] [curtain]` writes the files beside itself, in about a
minute. Imported by nothing. Needs numpy and scipy.

The solver is extended position-based dynamics with small substeps: Macklin, Mueller, Chentanez 2016 "XPBD" and Macklin
et al. 2019 "Small steps in physics simulation". A sheet is simulated coarse first and refined twice, so that the long
waves have settled before the short ones cost anything.

Every number comes from additions, multiplications, divisions and square roots, which IEEE 754 rounds exactly, in an
order that does not depend on the machine: the same bits everywhere. No random generator, no trigonometry, no BLAS.
"""
import argparse
import pathlib
import sys
import time

import numpy as np
from scipy.spatial import cKDTree

HERE = pathlib.Path(__file__).parent
GRAVITY = 9.81  # m/s^2
# Masses of two folds stay this far apart, in units of the grid's spacing. Above 1/sqrt(2) a mass cannot slip through
# the middle of a cell; below 1 the cloth's own neighbours do not feel it.
FOLD_GAP = 0.86


# ---- bodies: a signed distance and its gradient ----------------------------------------------------------------------

class Ball:
    """Sphere; centre [m], radius [m]."""

    def __init__(self, centre, radius):
        self.centre, self.radius = centre, radius

    def distance(self, p):
        """p (3, n) -> signed distance (n,), outward unit gradient (3, n)."""
        d = [p[k] - self.centre[k] for k in range(3)]
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        inverse = 1.0 / np.maximum(length, 1e-12)
        return length - self.radius, np.stack([d[0] * inverse, d[1] * inverse, d[2] * inverse])


class Drum:
    """Upright cylinder with its rims rounded off; foot centre [m], radius, height, rim radius [m]."""

    def __init__(self, foot, radius, height, rim):
        self.foot, self.radius, self.height, self.rim = foot, radius, height, rim

    def distance(self, p):
        """p (3, n) -> signed distance (n,), outward unit gradient (3, n). Exact outside, a bound inside."""
        x, z = p[0] - self.foot[0], p[2] - self.foot[2]
        y = p[1] - (self.foot[1] + 0.5 * self.height)
        rho = np.maximum(np.sqrt(x * x + z * z), 1e-12)
        a = rho - (self.radius - self.rim)
        b = np.abs(y) - (0.5 * self.height - self.rim)
        a0, b0 = np.maximum(a, 0.0), np.maximum(b, 0.0)
        corner = np.sqrt(a0 * a0 + b0 * b0)
        outside = corner > 0.0
        inverse = 1.0 / np.where(outside, corner, 1.0)
        side = np.where(outside, a0 * inverse, np.where(a > b, 1.0, 0.0))
        up = np.where(outside, b0 * inverse, np.where(a > b, 0.0, 1.0)) * np.where(y < 0.0, -1.0, 1.0)
        distance = corner + np.minimum(np.maximum(a, b), 0.0) - self.rim
        return distance, np.stack([side * x / rho, up, side * z / rho])


class Floor:
    """The half space y < 0."""

    def distance(self, p):
        """p (3, n) -> height (n,), gradient (3, n)."""
        gradient = np.zeros_like(p)
        gradient[1] = 1.0
        return p[1].copy(), gradient


# ---- the sheet -------------------------------------------------------------------------------------------------------

class Fabric:
    """What the solver knows of a cloth. density [kg/m^2], stretch and shear [N/m], bend [N m]."""

    def __init__(self, density, stretch, shear, bend, friction):
        self.density, self.stretch, self.shear, self.bend, self.friction = density, stretch, shear, bend, friction


class Sheet:
    """A grid of masses, p (3, rows, columns) in metres; columns run along u (weft), rows along v (warp).

    rest [m] is the distance between neighbours in the flat cloth; free (rows, columns) is 0 where a mass is held.
    """

    def __init__(self, p, rest, free, fabric):
        self.p, self.rest, self.free, self.fabric = p, rest, free, fabric
        self.v = np.zeros_like(p)

    def _link(self, first, second, length, softness):
        """Pulls the pairs p[first], p[second] toward `length`; softness = compliance * mass / dt^2, no unit."""
        a, b = self.p[(slice(None),) + first], self.p[(slice(None),) + second]
        wa, wb = self.free[first], self.free[second]
        d0, d1, d2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        now = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        pull = (now - length) / (np.maximum(now, 1e-9) * (wa + wb + softness))
        pa, pb = pull * wa, pull * wb
        a[0] += pa * d0
        a[1] += pa * d1
        a[2] += pa * d2
        b[0] -= pb * d0
        b[1] -= pb * d1
        b[2] -= pb * d2

    def _flatten(self, axis, start, softness):
        """Bending: straightens every third triple along an axis, C = |p0 - 2 p1 + p2| (Bergou et al. 2006)."""
        def pick(shift):
            count = (self.p.shape[axis + 1] - start) // 3
            along = slice(start + shift, start + shift + 3 * (count - 1) + 1, 3)
            return (along, slice(None)) if axis == 0 else (slice(None), along)
        if (self.p.shape[axis + 1] - start) // 3 < 1:
            return
        i, j, k = pick(0), pick(1), pick(2)
        wi, wj, wk = self.free[i], self.free[j], self.free[k]
        pull = 1.0 / (wi + 4.0 * wj + wk + softness)
        gi, gj, gk = pull * wi, 2.0 * pull * wj, pull * wk
        for x in self.p:
            bend = x[i] - 2.0 * x[j] + x[k]
            x[i] -= gi * bend
            x[j] += gj * bend
            x[k] -= gk * bend

    def _solve(self, dt):
        """One sweep over all constraints, colour by colour: no two of a colour share a mass."""
        f, h = self.fabric, self.rest
        mass = f.density * h * h
        whole = slice(None)
        for axis in (0, 1):
            for start in (0, 1, 2):
                self._flatten(axis, start, mass * h * h / (f.bend * dt * dt))
        diagonal = h * 1.4142135623730951
        shear = mass / (f.shear * dt * dt)
        low, high = slice(None, -1), slice(1, None)
        for start in (0, 1):
            a, b = slice(start, -1, 2), slice(start + 1, None, 2)
            self._link((a, low), (b, high), diagonal, shear)
            self._link((a, high), (b, low), diagonal, shear)
        stretch = mass / (f.stretch * dt * dt)
        for start in (0, 1):
            a, b = slice(start, -1, 2), slice(start + 1, None, 2)
            self._link((a, whole), (b, whole), h, stretch)
            self._link((whole, a), (whole, b), h, stretch)

    def _keep_apart(self, gap, pairs):
        """Pushes masses of different folds apart: those of the pairs (m, 2) of flat indices nearer than gap [m]."""
        flat = self.p.reshape(3, -1)
        free = self.free.reshape(-1)
        d = flat[:, pairs[:, 1]] - flat[:, pairs[:, 0]]
        now = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        close = now < gap
        a, b, d, now = pairs[close, 0], pairs[close, 1], d[:, close], now[close]
        push = 0.5 * (gap - now) / np.maximum(now, 1e-9)
        # Jacobi with averaging: a mass in many pairs must not be thrown by their sum
        count = np.maximum(np.bincount(a, minlength=free.size) + np.bincount(b, minlength=free.size), 1)
        for k in range(3):
            move = np.bincount(b, push * d[k], free.size) - np.bincount(a, push * d[k], free.size)
            flat[k] += free * move / count

    def _collide(self, before, bodies, gap):
        """Puts masses `gap` [m] off every body, with Coulomb friction against the substep's own motion."""
        flat, old = self.p.reshape(3, -1), before.reshape(3, -1)
        for body in bodies:
            distance, normal = body.distance(flat)
            hit = np.nonzero((distance < gap) & (self.free.reshape(-1) > 0.0))[0]
            if hit.size == 0:
                continue
            n, depth = normal[:, hit], gap - distance[hit]
            p = flat[:, hit] + n * depth
            move = p - old[:, hit]
            along = move[0] * n[0] + move[1] * n[1] + move[2] * n[2]
            slide = move - n * along
            length = np.sqrt(slide[0] * slide[0] + slide[1] * slide[1] + slide[2] * slide[2])
            hold = np.minimum(self.fabric.friction * depth / np.maximum(length, 1e-12), 1.0)
            flat[:, hit] = p - slide * hold

    def run(self, seconds, substeps, bodies=(), gap=0.0, damping=1.0, wind=None):
        """Simulates. substeps per 1/60 s; damping [1/s] of the velocity; wind(p) -> acceleration (3, rows, columns)."""
        dt = 1.0 / 60.0 / substeps
        keep = 1.0 / (1.0 + damping * dt)
        pairs = np.zeros((0, 2), int)
        steps = int(round(seconds / dt))
        apart = FOLD_GAP * self.rest
        for step in range(steps):
            before = self.p.copy()
            self.v[1] -= GRAVITY * dt * self.free
            if wind is not None:
                self.v += wind(self.p) * (dt * self.free)
            self.v *= keep
            self.p += self.v * dt
            self._solve(dt)
            if step % 4 == 0:
                pairs = cKDTree(self.p.reshape(3, -1).T).query_pairs(0.98 * self.rest, output_type="ndarray")
                pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
            self._keep_apart(apart, pairs)
            self._collide(before, bodies, gap)
            self.v = (self.p - before) * (1.0 / dt)
        return self

    def refined(self):
        """The same sheet on a grid of half the spacing: masses between are placed by the cubic (-1, 9, 9, -1) / 16."""
        def double(x, axis):
            x = np.moveaxis(x, axis, -1)
            ends = np.concatenate([2.0 * x[..., :1] - x[..., 1:2], x, 2.0 * x[..., -1:] - x[..., -2:-1]], -1)
            between = (9.0 * (ends[..., 1:-2] + ends[..., 2:-1]) - (ends[..., :-3] + ends[..., 3:])) * 0.0625
            out = np.empty(x.shape[:-1] + (2 * x.shape[-1] - 1,))
            out[..., 0::2], out[..., 1::2] = x, between
            return np.moveaxis(out, -1, axis)
        p = double(double(self.p, 1), 2)
        free = np.ones(p.shape[1:])
        free[::2, ::2] = self.free
        return Sheet(p, 0.5 * self.rest, free, self.fabric)


def flat_square(cells, side, height, centre, turn):
    """A flat cloth above the scene: p (3, cells+1, cells+1). u along (c, 0, -s), v along -(s, 0, c): front face is up.

    turn = (c, s), a point of the unit circle; hashed noise of a tenth of a millimetre breaks the symmetry.
    """
    k = np.arange(cells + 1) / cells - 0.5
    u, v = np.meshgrid(k * side, k * side)
    c, s = turn
    seed = (np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1) * 2654435761) % 4294967296
    noise = (seed / 4294967296.0 - 0.5) * 2e-4
    return np.stack([centre[0] + c * u - s * v, height + noise, centre[1] - s * u - c * v])


def least_clearance(p, bodies):
    """Least distance [m] from the sheet's vertices, and from 18 more points of each triangle, to the bodies."""
    flat = p.reshape(3, -1)
    corner = [flat[:, index] for index in grid_triangles(*p.shape[1:]).T]
    least = np.inf
    for i in range(6):
        for j in range(6 - i):
            points = (i * corner[0] + j * corner[1] + (5 - i - j) * corner[2]) / 5.0
            least = min(least, min(body.distance(points)[0].min() for body in bodies))
    return least


# ---- files -----------------------------------------------------------------------------------------------------------

def smooth_normals(p):
    """Area-weighted vertex normals of the grid's triangles, (3, rows, columns); front face by u x v."""
    def cross(a, b):
        return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    p00, p10, p01, p11 = p[:, :-1, :-1], p[:, :-1, 1:], p[:, 1:, :-1], p[:, 1:, 1:]
    lower, upper = cross(p10 - p00, p11 - p00), cross(p11 - p00, p01 - p00)
    n = np.zeros_like(p)
    n[:, :-1, :-1] += lower + upper
    n[:, :-1, 1:] += lower
    n[:, 1:, 1:] += lower + upper
    n[:, 1:, :-1] += upper
    return n / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])


def grid_triangles(rows, columns):
    """(2 (rows-1) (columns-1), 3) indices of the grid's triangles."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    a, b, c, d = first, first + 1, first + columns + 1, first + columns
    return np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)


def write_ply(path, p, comment):
    """Binary little-endian PLY of a grid p (3, rows, columns) [m]: x y z, nx ny nz, s t = UV over [0, 1]."""
    rows, columns = p.shape[1:]
    u, v = np.meshgrid(np.arange(columns) / (columns - 1), np.arange(rows) / (rows - 1))
    vertices = np.stack([*p, *smooth_normals(p), u, v], -1).reshape(-1, 8).astype("<f4")
    triangles = grid_triangles(rows, columns)
    faces = np.zeros(len(triangles), [("n", "u1"), ("i", "<i4", 3)])
    faces["n"], faces["i"] = 3, triangles
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "s", "t"))
    header = (f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {len(vertices)}\n{names}"
              f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    beside = path.with_suffix(".ply.part")
    beside.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())
    beside.replace(path)


# ---- the two shapes --------------------------------------------------------------------------------------------------

# What a scene puts under drape.ply: a ball on a plinth. The cloth is simulated over bodies a few millimetres larger,
# the plinth round-rimmed, so that the chords of its triangles clear the scene's faceted sphere and sharp cylinder.
BALL = {"radius": 0.21, "centre": (0.0, 0.80, 0.0)}
PLINTH = {"radius": 0.13, "height": 0.62}
DRAPE_SIDE = 1.40

CURTAIN_WIDE, CURTAIN_HIGH = 3.5, 1.75  # the flat cloth
CURTAIN_RAIL = 2.0  # what it is gathered to
CURTAIN_HOOKS = 25


def simulate_drape(log):
    """A soft square laid off-centre and turned over the ball; -> p (3, 181, 181)."""
    cotton = Fabric(density=0.20, stretch=4000.0, shear=50.0, bend=4e-5, friction=0.30)
    plinth = Drum((0.0, 0.0, 0.0), PLINTH["radius"] + 0.004, PLINTH["height"] + 0.002, 0.012)
    bodies = [Ball(BALL["centre"], BALL["radius"] + 0.002), plinth, Floor()]
    cells = 45
    flat = flat_square(cells, DRAPE_SIDE, 1.035, (0.05, 0.06), (0.8, 0.6))
    sheet = Sheet(flat, DRAPE_SIDE / cells, np.ones((cells + 1, cells + 1)), cotton)
    sheet.run(2.5, 12, bodies, 0.004, damping=1.5)
    log("drape 46 x 46")
    sheet = sheet.refined().run(1.2, 16, bodies, 0.004, damping=2.0)
    log("drape 91 x 91")
    sheet = sheet.refined().run(0.6, 20, bodies, 0.004, damping=6.0)
    scene_plinth = Drum((0.0, 0.0, 0.0), PLINTH["radius"], PLINTH["height"], 0.0)
    clearance = least_clearance(sheet.p, [Ball(BALL["centre"], BALL["radius"]), scene_plinth, Floor()])
    log(f"drape 181 x 181, {1e3 * clearance:.2f} mm clear of the ball, the plinth and the floor")
    assert clearance > 0.001
    return sheet.p


def hashed(count, salt):
    """`count` fixed numbers in [-0.5, 0.5) that look random."""
    k = (np.arange(count) + 1) * (2654435761 + 2 * salt) % 4294967296
    return (k ^ (k >> 15)) * 2246822519 % 4294967296 / 4294967296.0 - 0.5


def wave(t):
    """A smooth period-1 wave of height 1 from parabolas: like sin(2 pi t), without a library's rounding."""
    t = t - np.floor(t)
    half = np.where(t < 0.5, t, t - 0.5)
    return np.where(t < 0.5, 1.0, -1.0) * 16.0 * half * (0.5 - half)


def simulate_curtain(log):
    """A sheer cloth hooked to a straight rail along x, gathered to 2 m, in a breath of wind; -> p (3, 133, 265).

    The front face looks along +z and the lowest point of the hem has y = 0.
    """
    sheer = Fabric(density=0.06, stretch=1500.0, shear=60.0, bend=6e-6, friction=0.3)
    rows, columns = 66, 132
    h = CURTAIN_HIGH / rows
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(rows + 1) / rows)
    # hooks sit evenly on the cloth and a little unevenly on the rail
    spans = CURTAIN_HOOKS - 1
    hook_u = np.arange(CURTAIN_HOOKS) / spans
    hook_x = CURTAIN_RAIL * (hook_u - 0.5 + 0.35 / spans * hashed(CURTAIN_HOOKS, 1))
    hook_x[0], hook_x[-1] = -0.5 * CURTAIN_RAIL, 0.5 * CURTAIN_RAIL
    depth = 0.06 * (1.0 + 0.5 * hashed(CURTAIN_HOOKS, 2))
    span = np.minimum(np.floor(u * spans), spans - 1).astype(int)
    part = u * spans - span
    x = hook_x[span] * (1.0 - part) + hook_x[span + 1] * part
    z = (depth[span] * (1.0 - part) + depth[span + 1] * part) * wave(0.5 * spans * u)
    sheet = Sheet(np.stack([x, CURTAIN_HIGH * v, z]), h, np.ones(x.shape), sheer)
    hold = np.zeros(columns + 1, bool)
    hold[np.round(hook_u * columns).astype(int)] = True
    sheet.free[-1, hold] = 0.0

    def breath(p):
        # a push along +z that fades toward the rail and swells in the middle of the width
        wide = 1.0 - 4.0 / (CURTAIN_RAIL * CURTAIN_RAIL) * p[0] * p[0]
        out = np.zeros_like(p)
        out[2] = 1.1 * np.maximum(wide, -0.5)
        return out
    sheet.run(3.0, 16, damping=2.0, wind=breath)
    log("curtain 67 x 133")
    sheet = sheet.refined().run(0.5, 40, damping=6.0, wind=breath)
    log("curtain 133 x 265")
    sheet.p[1] -= sheet.p[1].min()
    return sheet.p


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shapes", nargs="*", metavar="SHAPE", help="drape, curtain; default both")
    parser.add_argument("-o", "--out", type=pathlib.Path, default=HERE, help="folder to write to")
    options = parser.parse_args()
    simulate = {"drape": simulate_drape, "curtain": simulate_curtain}
    for shape in options.shapes:
        if shape not in simulate:
            parser.error(f"found shape '{shape}', expected {' or '.join(simulate)}")
    start = time.monotonic()

    def log(what):
        print(f"{time.monotonic() - start:6.1f} s  {what}", file=sys.stderr)
    for shape in options.shapes or simulate:
        write_ply(options.out / f"{shape}.ply", simulate[shape](log), "made by assets/meshes/make_meshes.py")


if __name__ == "__main__":
    main()
