"""For each row of shared_rows.h: inputs (thousands of random ones and the edges), what the oracle expects of them, how the error
is measured, and whether 2e-5 can hold in float everywhere."""
import dataclasses
from typing import Callable

import numpy as np

import cloth_oracle as oracle
import evaluate

N = 4000


@dataclasses.dataclass
class Function:
    inputs: Callable          # rng -> (n, inputs)
    expect: Callable          # xs -> (n, outputs)
    groups: tuple = ()        # widths of outputs that are vectors: their error is measured against their length; () is each alone
    strict: bool = False      # float holds 2e-5 on every input; otherwise `why` says what stands in the way
    why: str = ""
    floor: float = 1e-30      # values below are nothing: the error is measured against at least this
    tables: bool = False      # reads maps or lights
    exact: bool = False       # all bits agree
    slack: Callable = None    # xs -> rounding of the stable form itself, in units in the last place of 1
    loose: float = 0.005      # share of inputs that may need the allowance for ill-conditioned inputs


FUNCTIONS = {}


def function(name, **options):
    def register(pair):
        FUNCTIONS[name] = Function(*pair(), **options)
        return pair
    return register


# ---- inputs ------------------------------------------------------------------------------------------------------------------

def sphere(rng, n):
    return oracle.unit(rng.normal(size=(n, 3)))


def viewer(rng, n):
    """z > 0: uniform over the hemisphere, a quarter of them grazing down to 1e-6."""
    d = sphere(rng, n)
    d[:, 2] = np.abs(d[:, 2])
    grazing = rng.random(n) < 0.25
    d[grazing, 2] = 10 ** rng.uniform(-6, -1, grazing.sum())
    return oracle.unit(d)


def alphas(rng, n):
    return np.clip(10 ** rng.uniform(-2.05, 0.02, n), 0.01, 1)[:, None]


def fibres(rng, w, n):
    """Tangents: any, nearly along w, exactly along w, across w."""
    t = sphere(rng, n)
    kind = rng.integers(0, 8, n)
    near = oracle.unit(w + sphere(rng, n) * 10 ** rng.uniform(-7, -1, (n, 1)))
    across = oracle.unit(np.cross(w, sphere(rng, n)))
    return np.where((kind == 0)[:, None], near, np.where((kind == 1)[:, None], w, np.where((kind == 2)[:, None], across, t)))


def opposite(rng, o, n):
    """Directions of the light: any, near the mirror image -o, near o, exactly both, in the plane."""
    kind = rng.integers(0, 10, n)[:, None]
    near = 10 ** rng.uniform(-7, -1, (n, 1)) * sphere(rng, n)
    i = np.where(kind == 0, -o, np.where(kind == 1, oracle.unit(near - o), np.where(kind == 2, oracle.unit(near + o), sphere(rng, n))))
    i = np.where(kind == 3, o, i)
    i[:, 2] = np.where(kind[:, 0] == 4, 0, i[:, 2])
    return oracle.unit(i)


def slopes(rng, n):
    s = rng.normal(size=(n, 2)) * 0.7
    s[rng.random(n) < 0.1] *= 6
    return np.clip(s, -4, 4)


def points(rng, n):
    """11 numbers: normals and tangent as the maps give them."""
    f, b = slopes(rng, n), slopes(rng, n)
    n_f, n_b = np.c_[-f, np.ones(n)], np.c_[-b, np.ones(n)]
    len_f, len_b = np.linalg.norm(n_f, axis=1), np.linalg.norm(n_b, axis=1)
    n_f, n_b = n_f / len_f[:, None], n_b / len_b[:, None]
    phi, omega = rng.uniform(0, np.pi, n), rng.uniform(-1, 1, n)[:, None]
    t = oracle.unit(np.c_[np.cos(phi), np.sin(phi), f[:, 0] * np.cos(phi) + f[:, 1] * np.sin(phi)])
    t = np.cos(omega) * t + np.sin(omega) * np.cross(n_f, t)
    return np.c_[n_f, n_b, t, len_f, len_b]


def yarns(rng, n):
    """17 numbers; a twentieth have no light of some lobe, a few none at all."""
    colours = rng.random((n, 12))
    for first in (0, 3, 6, 9):
        colours[rng.random(n) < 0.05, first:first + 3] = 0
    colours[rng.random(n) < 0.01] = 0
    thickness = 10 ** rng.uniform(-2, 1, n)
    mix = np.where(rng.random(n) < 0.3, 1, rng.random(n))
    return np.c_[colours, alphas(rng, n), alphas(rng, n), thickness, rng.uniform(-1, 1, n), mix]


def units(rng, n, width):
    """[0, 1) as the random numbers are: multiples of 2^-24, both ends included."""
    u = rng.integers(0, 2**24, (n, width)) / 2**24
    u[rng.random((n, width)) < 0.01] = 0
    u[rng.random((n, width)) < 0.01] = 1 - 2**-24
    return u


def words(rng, n):
    """32 random bits as two halves."""
    return rng.integers(0, 65536, (n, 2)).astype(float)


def word(xs, k):
    return (xs[:, k].astype(np.uint64) | (xs[:, k + 1].astype(np.uint64) << np.uint64(16))).astype(np.uint32)


def halves(values):
    values = np.asarray(values, np.uint64)
    return np.stack([values & np.uint64(0xffff), values >> np.uint64(16)], -1).astype(float)


# ---- tables ------------------------------------------------------------------------------------------------------------------

def make_tables(seed=5, size=(24, 16)):
    """A fabric of noise with gaps, and lights: no structure that an index error could hide behind."""
    rng = np.random.default_rng(seed)
    w, h = size
    def slope_words(n):
        s = np.rint(slopes(rng, n) * 32767 / 4).astype(np.int64) & 0xffff
        return (s[:, 0] | (s[:, 1] << 16)).astype(np.uint32)
    gap = rng.random(w * h) < 0.3
    yarn = rng.integers(0, 3, w * h)
    texels = []
    for _ in range(2):
        azimuth, openness = rng.integers(0, 65536, w * h), rng.integers(0, 256, w * h)
        packed = azimuth | (yarn << 16) | (gap.astype(np.int64) << 23) | (openness << 24)
        x = np.where(gap, 0, slope_words(w * h)).astype(np.uint32)
        texels.append(np.stack([x, packed.astype(np.uint32)], -1).reshape(h, w, 2))
    def knots():
        k = np.minimum(rng.exponential(60, (w * h, 8)), 255).astype(np.uint64)
        return np.stack([sum(k[..., 4 * part + j] << np.uint64(8 * j) for j in range(4)) for part in (0, 1)], -1).astype(np.uint32)
    sizes = [(max(1, w >> k), max(1, h >> k)) for k in range(1, int(np.log2(max(w, h))) + 1)]
    mips = tuple(slope_words(sum(a * b for a, b in sizes)) for _ in range(2))
    ew, eh = 16, 8
    environment = np.abs(rng.normal(size=(eh, ew, 4))) + 0.05
    sine = np.sin((np.arange(eh) + 0.5) / eh * np.pi)[:, None]
    density = environment[..., :3].sum(-1) * sine
    environment[..., 3] = density / density.mean()
    lights = np.concatenate([lights_of_kind(rng, 1, kind) for kind in range(7)])
    lights[:, 1] = [0.3, 0.1, 0.2, 0.1, 0.05, 0.15, 0.1]
    return evaluate.Tables(tuple(texels), (knots(), knots()), mips, yarns(rng, 3).astype("f4"), lights.astype("f4"),
                           environment.astype("f4"), evaluate.inversion_table(environment[..., 3]), *relief(rng, size), EMITTERS)


def relief(rng, size):
    """Heights, hills under noise; an ASG for each texel."""
    w, h = size
    x, y = np.meshgrid(np.arange(w) / w, np.arange(h) / h)
    heights = 0.5 + 0.3 * np.sin(2 * np.pi * (2 * x + y)) + 0.2 * rng.random((h, w)) - 0.1
    asg = np.c_[viewer(rng, w * h), rng.uniform(-4, 4, w * h), rng.uniform(0.5, 40, (w * h, 2)), rng.uniform(0, 2, w * h), np.zeros(w * h)]
    return np.rint(heights.ravel() * 65535).astype(np.uint16), asg.reshape(-1, 4).astype("f4")


EMITTER_RANGES = ((0, 8), (8, 12))   # first triangle and count of two objects


def make_emitters(seed=6):
    """Triangles of two objects with any alias table: 13 numbers each, corner, two edges, threshold and other in halves."""
    rng = np.random.default_rng(seed)
    rows = []
    for _, count in EMITTER_RANGES:
        words = np.stack([rng.integers(0, 2**32, count, dtype=np.uint64), rng.integers(0, count, count, dtype=np.uint64)], -1)
        rows.append(np.c_[rng.normal(size=(count, 3)) * 3, rng.normal(size=(count, 6)), halves(words).reshape(count, 4)])
    return np.concatenate(rows).astype("f4")


def mesh_lights(rng, n):
    lights = np.zeros((n, 19))
    for k, (first, count) in enumerate(EMITTER_RANGES):
        rows = np.arange(n) % len(EMITTER_RANGES) == k
        part = EMITTERS[first:first + count].astype("f8")
        corners = np.concatenate([part[:, :3], part[:, :3] + part[:, 3:6], part[:, :3] + part[:, 6:9]])
        centre = corners.mean(0)
        area = 0.5 * np.linalg.norm(np.cross(part[:, 3:6], part[:, 6:9]), axis=1).sum()
        lights[rows] = np.r_[6, 1, centre, 0, 0, 1, 0, 0, 0, area, 1.001 * np.linalg.norm(corners - centre, axis=1).max(), 0, 0, 0, 0, first, count]
    lights[:, 8:11] = rng.random((n, 3)) * 10
    return lights


def lights_of_kind(rng, n, kind):
    """19 numbers each: kind, pmf, position, axis, radiance, edge_u, edge_v, shape."""
    if kind == 6:
        return mesh_lights(rng, n)
    axis = sphere(rng, n)
    f = oracle.frame(axis)
    size = rng.uniform(0.1, 2, (n, 2))
    cone = np.cos(rng.uniform(0.2, 1.4, n))
    shape = {0: np.c_[rng.uniform(-7, 7, n), np.zeros(n)],
             1: np.c_[np.where(rng.random(n) < 0.2, 0, 1 - np.cos(10 ** rng.uniform(-3, 0, n))), np.zeros(n)],
             3: np.c_[cone, cone + (1 - cone) * rng.uniform(0.05, 0.9, n)]}.get(kind, np.zeros((n, 2)))
    return np.c_[np.full(n, kind), np.ones(n), rng.normal(size=(n, 3)) * 3, axis, rng.random((n, 3)) * 10,
                 f[:, 0] * size[:, :1], f[:, 1] * size[:, 1:], shape]


EMITTERS = make_emitters()
TABLES = make_tables()
MAPS = oracle.Maps(TABLES)
IMAGE = TABLES.environment.astype("f8")


# ---- cloth_bsdf.h -------------------------------------------------------------------------------------------------------------

@function("frame", groups=(3, 3, 3), strict=True)
def _():
    def inputs(rng):
        n = sphere(rng, N)
        n[:8] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-7, 0, -1], [0, 1e-4, -1], [-1, 0, 0], [0, 1, 0]]
        return oracle.unit(n)
    return inputs, lambda xs: oracle.frame(xs).reshape(-1, 9)


@function("unit_vector", groups=(3,), strict=True)
def _():
    def inputs(rng):
        v = sphere(rng, N) * 10 ** rng.uniform(-9, 9, (N, 1))
        v[:4] = [[0, 0, 0], [1e-11, 0, 0], [0, 1e-12, 1e-12], [1e-20, 1e-20, 0]]
        return np.c_[v, sphere(rng, N)]
    def expect(xs):
        v = xs[:, :3]
        length2 = oracle.dot(v, v)
        tiny = length2 < 1e-20
        return np.where(tiny[:, None], xs[:, 3:], v / np.sqrt(np.where(tiny, 1, length2))[:, None])
    return inputs, expect


@function("sggx_sigma", strict=True)
def _():
    def inputs(rng):
        w = sphere(rng, N)
        return np.c_[w, fibres(rng, w, N), alphas(rng, N)]
    return inputs, lambda xs: oracle.sggx_sigma(xs[:, :3], xs[:, 3:6], xs[:, 6])


@function("sggx_d", strict=True)
def _():
    def inputs(rng):
        h = sphere(rng, N)
        return np.c_[h * 10 ** rng.uniform(-3, 1, (N, 1)), fibres(rng, h, N), alphas(rng, N)]
    return inputs, lambda xs: oracle.sggx_d(xs[:, :3], xs[:, 3:6], xs[:, 6])


@function("sggx_d_antiparallel", strict=True)
def _():
    def inputs(rng):
        o = sphere(rng, N)
        return np.c_[o, fibres(rng, o, N), alphas(rng, N)]
    return inputs, lambda xs: oracle.sggx_d_antiparallel(xs[:, :3], xs[:, 3:6], xs[:, 6])


@function("sggx_d_half", strict=True)
def _():
    def inputs(rng):
        o = sphere(rng, N)
        i = opposite(rng, o, N)
        h = i + o
        # The limit's threshold itself is a jump, which rounding may take on either side.
        i = np.where((np.abs(np.log10(oracle.dot(h, h) + 1e-30) + 8) < 0.2)[:, None], o, i)
        return np.c_[i, o, fibres(rng, o, N), alphas(rng, N)]
    return inputs, lambda xs: oracle.sggx_d_half(xs[:, :3], xs[:, 3:6], xs[:, 6:9], xs[:, 9])


def stretch_slack(w, t, alpha, u):
    """Rounding of a unit vector, divided by the length that the stretch leaves of it, on the way there and on the way back."""
    m = oracle.sggx_sample_vndf(w, t, alpha, u)
    c = oracle.dot(m, oracle.unit(t))
    return 8 / oracle.sggx_sigma(w, t, alpha) * np.sqrt(np.maximum(0, 1 - c * c) + (c / alpha) ** 2)


@function("sggx_sample_vndf", groups=(3,), slack=lambda xs: stretch_slack(xs[:, :3], xs[:, 3:6], xs[:, 6], xs[:, 7:9]),
          why="the stretch by 1/alpha magnifies rounding where w and the sample lie along the fibre")
def _():
    def inputs(rng):
        w = sphere(rng, N)
        t = fibres(rng, w, N)
        # Exactly across the fibre, the basis about the stretched w jumps.
        level = np.abs(oracle.dot(w, t)) < 1e-4
        return np.c_[w, np.where(level[:, None], oracle.unit(t + 1e-3 * w), t), alphas(rng, N), units(rng, N, 2)]
    return inputs, lambda xs: oracle.sggx_sample_vndf(xs[:, :3], xs[:, 3:6], xs[:, 6], xs[:, 7:9])


@function("phi1", strict=True)
def _():
    def inputs(rng):
        return np.r_[0, 1e-30, 0.1, np.nextafter(0.1, 0), 80, 1e8, 10 ** rng.uniform(-12, 5, N)][:, None]
    return inputs, lambda xs: oracle.phi1(xs[:, 0])


def slab_inputs(rng):
    def cosine():
        c = 10 ** rng.uniform(-9, 0, N)
        c[rng.random(N) < 0.05] = 0
        return c
    c_i, c_o = cosine(), cosine()
    sigma_i, sigma_o = 10 ** rng.uniform(-2, 0, N), 10 ** rng.uniform(-2, 0, N)
    same = rng.random(N) < 0.2
    c_o[same], sigma_o[same] = c_i[same], sigma_i[same]
    return np.c_[10 ** rng.uniform(-4, 1.5, N), sigma_i, sigma_o, c_i, c_o, 10 ** rng.uniform(-3, 1.5, N)]


@function("slab_reflect", strict=True)
def _():
    return slab_inputs, lambda xs: oracle.slab_reflect(*xs.T)


@function("slab_transmit", floor=1e-20, strict=True)
def _():
    return slab_inputs, lambda xs: oracle.slab_transmit(*xs.T)


@function("diffuse", strict=True)
def _():
    def inputs(rng):
        i = viewer(rng, N)
        mix = rng.random(N)
        mix[:50], mix[50:100] = 0, 1
        return np.c_[points(rng, N)[:, :3], i, mix]
    return inputs, lambda xs: oracle.diffuse(oracle.unit(xs[:, :3]), xs[:, 3:6], xs[:, 6])


def point_inputs(rng):
    o = viewer(rng, N)
    i = opposite(rng, o, N)
    h = i + o
    i = np.where((np.abs(np.log10(oracle.dot(h, h) + 1e-30) + 8) < 0.2)[:, None], o, i)
    return np.c_[points(rng, N), yarns(rng, N), i, o]


def split_point(xs):
    return oracle.Point(xs[:, :11], xs[:, 11:28])


def split_beneath(xs):
    return oracle.Point(xs[:, :11], xs[:, 11:28], xs[:, 35:38], xs[:, 38])


@function("point_value", floor=1e-7, strict=True)
def _():
    return (lambda rng: np.c_[point_inputs(rng), rng.integers(0, 2, N)],
            lambda xs: oracle.point_value(split_point(xs), xs[:, 28:31], xs[:, 31:34], xs[:, 34] == 1))


@function("unscattered", floor=1e-6, why="exp(-x) has x times the relative error of x, here up to 14 times that of a cosine near 0")
def _():
    def expect(xs):
        p, o = split_point(xs), xs[:, 28:31]
        depth = (p.thickness + xs[:, 31]) * oracle.sggx_sigma(o, p.t, p.alpha_t) / np.maximum(oracle.dot(p.n_f, o), 1e-6)
        return np.exp(-np.minimum(depth, 80))
    # Under one yarn in two lies another.
    return lambda rng: np.c_[points(rng, N), yarns(rng, N), viewer(rng, N), 10 ** rng.uniform(-2, 1, N) * rng.integers(0, 2, N)], expect


@function("interreflection", groups=(3, 3), strict=True)
def _():
    return lambda rng: units(rng, N, 5), lambda xs: np.hstack([oracle.interreflection(xs[:, :3], xs[:, side]) for side in (3, 4)])


@function("lobe_weights", strict=True)
def _():
    return lambda rng: yarns(rng, N), lambda xs: oracle.lobe_weights(oracle.Point(np.ones((len(xs), 11)), xs))


@function("point_pdf", floor=1e-7, strict=True)
def _():
    return point_inputs, lambda xs: oracle.point_pdf(split_point(xs), xs[:, 28:31], xs[:, 31:34])


@function("cosine_sample", groups=(3,), strict=True)
def _():
    return lambda rng: np.c_[sphere(rng, N), units(rng, N, 2)], \
        lambda xs: oracle.to_world(oracle.frame(oracle.unit(xs[:, :3])), oracle.cosine_direction(xs[:, 3:5]))


def slack_of_sample(p, o, u_lobe, u):
    """The direction's, and the pdf's change by it: at most 4/alpha of itself per radian [D' / D = 4 c / (alpha^2 + c^2)]."""
    low = np.minimum(p.alpha_r, p.alpha_t)
    turn = np.maximum(stretch_slack(o, p.t, p.alpha_r, u), stretch_slack(o, p.t_t, p.alpha_t, u))
    _, pdf = oracle.point_sample(p, o, u_lobe, u)
    return np.c_[turn, turn, turn, turn * pdf * 4 / low]


def sample_slack(xs):
    return slack_of_sample(split_point(xs), xs[:, 28:31], xs[:, 31:33], xs[:, 33:35])


def beneath_slack(xs):
    return slack_of_sample(split_beneath(xs), xs[:, 31:34], xs[:, 39:41], xs[:, 41:43])


@function("point_sample", groups=(3, 1), floor=1e-7, loose=0.02, slack=sample_slack,
          why="as sggx_sample_vndf; the pdf is that of a slightly different direction")
def _():
    def inputs(rng):
        return np.c_[points(rng, N), yarns(rng, N), viewer(rng, N), units(rng, N, 4)]
    def expect(xs):
        i, pdf = oracle.point_sample(split_point(xs), xs[:, 28:31], xs[:, 31:33], xs[:, 33:35])
        return np.c_[i, pdf]
    return inputs, expect


@function("point_beneath", groups=(3, 1, 3, 1), floor=1e-7, loose=0.02, why="as point_sample",
          slack=lambda xs: np.c_[np.zeros((len(xs), 4)), beneath_slack(xs)])
def _():
    """Of two yarns over each other: the lower one bends what passes."""
    def inputs(rng):
        xs = point_inputs(rng)
        return np.c_[xs, rng.integers(0, 2, N), sphere(rng, N), 10 ** rng.uniform(-2, 1, N), units(rng, N, 4)]
    def expect(xs):
        p, o = split_beneath(xs), xs[:, 31:34]
        i, pdf = oracle.point_sample(p, o, xs[:, 39:41], xs[:, 41:43])
        return np.c_[oracle.point_value(p, xs[:, 28:31], o, xs[:, 34] == 1), oracle.point_pdf(p, xs[:, 28:31], o), i, pdf]
    return inputs, expect


# ---- cloth_metal.h --------------------------------------------------------------------------------------------------------------

def metal_alphas(rng, n):
    return np.clip(10 ** rng.uniform(-3.05, 0.02, n), 1e-3, 1)[:, None]


def metal_pairs(rng, alpha):
    """(i, o): half of the lights inside the lobe, the others anywhere, below the surface too."""
    n = len(alpha)
    o = viewer(rng, n)
    h = oracle.unit(np.c_[alpha * rng.normal(size=(n, 2)), np.ones(n)])
    i = oracle.unit(2 * oracle.dot(o, h)[:, None] * h - o)
    return np.where(rng.random((n, 1)) < 0.5, i, sphere(rng, n)), o


@function("ggx_d", strict=True)
def _():
    def inputs(rng):
        alpha = metal_alphas(rng, N)
        return np.c_[oracle.unit(np.c_[alpha * rng.normal(size=(N, 2)) * 2, np.ones(N)]), alpha]
    return inputs, lambda xs: oracle.ggx_d(xs[:, :3], xs[:, 3])


@function("ggx_stretch", strict=True)
def _():
    return (lambda rng: np.c_[viewer(rng, N), metal_alphas(rng, N)],
            lambda xs: xs[:, 2] * (1 + 2 * oracle.ggx_lambda(xs[:, :3], xs[:, 3])))


@function("fresnel_schlick", groups=(3,), strict=True)
def _():
    return lambda rng: np.c_[rng.random((N, 3)), np.r_[0, 1, rng.random(N - 2)]], lambda xs: oracle.schlick(xs[:, :3], xs[:, 3])


MIRROR = "half vectors of a near mirror differ from the normal by less than a float tells of i + o"


@function("metal_value", groups=(3,), loose=0.5, floor=1e-12, why=MIRROR)
def _():
    def inputs(rng):
        alpha = metal_alphas(rng, N)
        return np.c_[rng.random((N, 3)), alpha, np.hstack(metal_pairs(rng, alpha))]
    return inputs, lambda xs: oracle.metal_value(xs[:, :3], xs[:, 3], xs[:, 4:7], xs[:, 7:10])


@function("metal_pdf", loose=0.5, floor=1e-12, why=MIRROR)
def _():
    def inputs(rng):
        alpha = metal_alphas(rng, N)
        return np.c_[alpha, np.hstack(metal_pairs(rng, alpha))]
    return inputs, lambda xs: oracle.metal_pdf(xs[:, 0], xs[:, 1:4], xs[:, 4:7])


def metal_sample_slack(xs):
    """The pdf is that of the direction after rounding: one unit of i moves h by as much over 2 o.h, and ln D by 2 / alpha times that."""
    i, pdf = oracle.metal_sample(xs[:, 0], xs[:, 1:4], xs[:, 4:6])
    cosine = np.maximum(oracle.dot(oracle.unit(i + xs[:, 1:4]), xs[:, 1:4]), 1e-9)
    return np.c_[np.zeros((len(xs), 3)), 4 * pdf / (xs[:, 0] * cosine)]


@function("metal_sample", groups=(3, 1), loose=0.6, floor=1e-6, slack=metal_sample_slack, why=MIRROR + "; the rim of the cap is where 1 - z^2 vanishes")
def _():
    def inputs(rng):
        return np.c_[metal_alphas(rng, N), viewer(rng, N), units(rng, N, 2)]
    def expect(xs):
        i, pdf = oracle.metal_sample(xs[:, 0], xs[:, 1:4], xs[:, 4:6])
        return np.c_[i, pdf]
    return inputs, expect


# ---- cloth_visibility.h, cloth_maps.h, cloth_footprint.h ----------------------------------------------------------------------------

@function("horizon_azimuth", floor=1.0, strict=True)
def _():
    def inputs(rng):
        d = rng.normal(size=(N, 2))
        d[:13] = [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1], [1e-30, 0], [1, -1e-12], [1e-6, 1], [-1, 1e-9]]
        return d
    return inputs, lambda xs: oracle.horizon_azimuth(xs)


@function("horizon_step", floor=1.0, strict=True)
def _():
    def inputs(rng):
        s = np.r_[0, 0, 0, 1, 1, 1e-9, rng.integers(0, 256, N) / 255]
        z = np.r_[0, 1e-9, 1, 1, 0.5, 1e-9, rng.random(N)]
        return np.c_[s, z]
    return inputs, lambda xs: oracle.horizon_step(xs[:, 0], xs[:, 1])


@function("horizon_visibility", floor=1.0, strict=True)
def _():
    def inputs(rng):
        k = np.minimum(rng.exponential(60, (N, 8)), 255).astype(np.uint64)
        k[:50], k[50:60] = 0, 255
        packed = sum(k[..., j::4] << np.uint64(8 * j) for j in range(4))     # (N, 2)
        return np.c_[halves(packed).reshape(N, 4), np.r_[viewer(rng, N - 100), sphere(rng, 100)]]
    def expect(xs):
        return oracle.horizon_visibility(oracle.unpack_knots(np.stack([word(xs, 0), word(xs, 2)], -1)), xs[:, 4:7])
    return inputs, expect


@function("cap_visibility", floor=1.0, loose=0.02, why="the rim is 1/10 of a radius wide: caps of small axes magnify a direction's rounding")
def _():
    def inputs(rng):
        mean = viewer(rng, N)
        x, y = (np.rint(mean[:, k] * 32767).astype(np.int64) & 0xffff for k in (0, 1))
        axes = np.rint(rng.uniform(0, 1.6, (N, 2)) * 2047 / 4).astype(np.int64)
        axes[:20], axes[20:30] = 0, 2047
        second = rng.integers(0, 1024, N) | axes[:, 0] << 10 | axes[:, 1] << 21
        d = np.where(rng.random((N, 1)) < 0.5, oracle.unit(mean + 0.5 * sphere(rng, N)), viewer(rng, N))
        return np.c_[x, y, halves(second), d]
    def expect(xs):
        return oracle.cap_visibility(np.stack([word(xs, 0), word(xs, 2)], -1), xs[:, 4:7])
    return inputs, expect


def visibility_of_kind(x):
    side, spot, kind, d = int(x[0]), x[1:3].astype(int), int(x[3]), x[4:7]
    tx, ty = spot // 4
    if kind == 0:
        return float(d[2] > 0)
    if kind == 1:
        return MAPS.visibility(side, spot, d)
    if kind == 2:
        a = MAPS.asg[ty, tx]
        return float(oracle.asg_visibility(a[None, :3], *(a[None, k] for k in (3, 4, 5, 6)), oracle.unit(d[None]))[0])
    if kind == 3:
        return MAPS.visibility16(side, spot, d)
    if kind == 4:
        return float(oracle.cap_visibility(MAPS.words[side][ty * MAPS.w + tx][None], d[None])[0])
    return float(clearance(x) >= 0)


def clearance(x):
    side = int(x[0])
    return MAPS.clearance(side, int(x[1]) // 4, int(x[2]) // 4, x[4:7], x[7:9], x[9 + side], x[11 + side])


def grazing_slack(xs):
    """A ray within 1e-4 of the height range of the relief: hundreds of steps round its place to 1e-4 texels, and slopes are steep."""
    return np.array([1e9 if int(x[3]) == 5 and abs(clearance(x)) < 1e-4 else 0 for x in xs])[:, None]


@function("visibility_at", tables=True, floor=1.0, loose=0.01, slack=grazing_slack,
          why="a ray that grazes the relief falls either way; caps have steep rims")
def _():
    def inputs(rng):
        w, h = MAPS.w, MAPS.h
        low = rng.uniform(-1e-3, 0, (N, 2))
        return np.c_[rng.integers(0, 2, N), rng.integers(0, 4 * w, N), rng.integers(0, 4 * h, N), rng.integers(0, 6, N), viewer(rng, N),
                     rng.uniform(5e-4, 5e-3, (N, 2)), low, low + 10 ** rng.uniform(-5, -3, (N, 2))]
    return inputs, lambda xs: np.array([visibility_of_kind(x) for x in xs])


@function("decode_slopes", strict=True)
def _():
    def inputs(rng):
        edges = [[0, 0], [0xffff, 0xffff], [0x7fff, 0x8001], [0x8000, 0x8000], [1, 0], [0, 1]]
        return np.r_[edges, words(rng, N)]
    return inputs, lambda xs: oracle.decode_slopes(word(xs, 0))


@function("texel_at", tables=True, floor=1.0, why="a position on a texel's edge belongs to either", loose=0.005)
def _():
    def inputs(rng):
        t = rng.uniform(-3, 3, (N, 2))
        t[:6] = [[0, 0], [1, 1], [-1, -2], [1 - 2**-24, 2**-24], [-1e-9, -1e-12], [0.5, 0.25]]
        return t
    return inputs, lambda xs: np.array([MAPS.texel_at(t) for t in xs], float)


def every_texel(rng):
    w, h = MAPS.w, MAPS.h
    return np.array([(s, x, y) for s in (0, 1) for y in range(h) for x in range(w)], float)


@function("texel", tables=True, groups=(3, 3, 3, 1, 1, 2, 1, 1, 1), strict=True)
def _():
    return every_texel, lambda xs: np.array([MAPS.texel(*map(int, x)) for x in xs])


@function("horizon_at", tables=True, strict=True)
def _():
    def inputs(rng):
        return np.array([(x, y) for y in range(4 * MAPS.h) for x in range(4 * MAPS.w)], float)
    return inputs, lambda xs: np.array([MAPS.horizon_at(x) for x in xs.astype(int)], float)


@function("mean_slopes", tables=True, strict=True)
def _():
    def inputs(rng):
        return np.c_[rng.integers(0, 2, N), rng.uniform(-2, 2, (N, 2)), rng.integers(0, 12, N)]
    return inputs, lambda xs: np.array([MAPS.mean_slopes(int(x[0]), x[1:3], int(x[3])) for x in xs])


def footprints(rng, n):
    return np.c_[rng.uniform(-2, 2, (n, 2)), rng.normal(size=(n, 4)) * 10 ** rng.uniform(-4, 1, (n, 1))]


@function("area_from_mips", tables=True, loose=0.005, why="a footprint at the edge between two mip levels belongs to either; o.z less the slopes cancels")
def _():
    def inputs(rng):
        return np.c_[rng.integers(0, 2, N), footprints(rng, N), viewer(rng, N)]
    return inputs, lambda xs: np.array([MAPS.area_from_mips(int(x[0]), x[1:3], x[3:5], x[5:7], x[7:10]) for x in xs])


@function("select", tables=True, groups=(1, 1, 3, 3, 3, 1, 1, 2, 1, 1, 1), loose=0.005, why="a choice at its edge falls either way")
def _():
    def inputs(rng):
        n = 1500
        return np.c_[rng.integers(0, 2, n), footprints(rng, n), viewer(rng, n), rng.integers(0, 2, (n, 3)), words(rng, n),
                     rng.integers(0, 64, n), np.zeros(n), 16 * rng.integers(0, 4, n)]
    def expect(xs):
        seeds = word(xs, 13)
        return np.array([oracle.select(MAPS, int(x[0]), x[1:3], x[3:5], x[5:7], x[7:10], int(x[10]), int(x[11]), int(x[12]),
                                       int(seed), int(x[15]), int(x[17])) for x, seed in zip(xs, seeds)])
    return inputs, expect


@function("bend", tables=True, groups=(3, 3, 1, 1), strict=True)
def _():
    def inputs(rng):
        xs = every_texel(rng)
        return np.c_[xs, units(rng, len(xs), 1)]
    return inputs, lambda xs: np.array([MAPS.bend(*map(int, x[:3]), x[3]) for x in xs])


@function("transmittance", tables=True, floor=1e-6, loose=0.005, why="a position on a texel's edge belongs to either")
def _():
    def inputs(rng):
        d = viewer(rng, N) * np.where(rng.random((N, 1)) < 0.5, 1, -1)
        return np.c_[rng.uniform(-2, 2, (N, 2)), d, rng.integers(0, 2, (N, 3))]
    return inputs, lambda xs: np.array([float(oracle.transmittance(MAPS, x[:2], x[2:5], int(x[5]), int(x[6]), int(x[7]))) for x in xs])


@function("asg_visibility", strict=True, floor=1e-6)
def _():
    def inputs(rng):
        return np.c_[viewer(rng, N), rng.uniform(-4, 4, N), rng.uniform(0.5, 40, (N, 2)), rng.uniform(0, 2, N), np.zeros(N), viewer(rng, N)]
    return inputs, lambda xs: oracle.asg_visibility(oracle.unit(xs[:, :3]), xs[:, 3], xs[:, 4], xs[:, 5], xs[:, 6], oracle.unit(xs[:, 8:11]))


@function("noise", strict=True, floor=0.1)
def _():
    return (lambda rng: np.c_[words(rng, N), words(rng, N), units(rng, N, 2)],
            lambda xs: oracle.noise(word(xs, 0), word(xs, 2), xs[:, 4:6]))


# ---- cloth_surface.h --------------------------------------------------------------------------------------------------------------

@function("camera_ray", groups=(3, 3, 3, 3), floor=1e-12, strict=True)
def _():
    def inputs(rng):
        f = oracle.frame(sphere(rng, N))
        size = rng.integers(1, 4096, (N, 2))
        tan = rng.uniform(0.05, 1.5, (N, 2))
        return np.c_[rng.normal(size=(N, 3)), f[:, 2], f[:, 0] * tan[:, :1], f[:, 1] * tan[:, 1:], size, rng.random((N, 2)) * size]
    def expect(xs):
        return np.concatenate(oracle.camera_ray(xs[:, :3], xs[:, 3:6], xs[:, 6:9], xs[:, 9:12], xs[:, 12:14], xs[:, 14:16]), -1)
    return inputs, expect


@function("lens_camera", groups=(3, 3), strict=True)
def _():
    def inputs(rng):
        f = oracle.frame(sphere(rng, N))
        tan = rng.uniform(0.05, 1.5, (N, 2))
        radius = np.where(rng.random(N) < 0.1, 0, 10 ** rng.uniform(-4, 0, N))
        return np.c_[rng.normal(size=(N, 3)), f[:, 2], f[:, 0] * tan[:, :1], f[:, 1] * tan[:, 1:], np.ones((N, 2)), radius, 10 ** rng.uniform(-1, 2, N), units(rng, N, 2)]
    def expect(xs):
        position, forward, right, up, radius, focus, u = xs[:, :3], xs[:, 3:6], xs[:, 6:9], xs[:, 9:12], xs[:, 14:15], xs[:, 15:16], xs[:, 16:]
        disk = np.sqrt(u[:, :1]) * np.c_[np.cos(2 * np.pi * u[:, 1]), np.sin(2 * np.pi * u[:, 1])]
        point = position + radius * (oracle.unit(right) * disk[:, :1] + oracle.unit(up) * disk[:, 1:])
        # The middle of the plane in focus is seen in the middle of the picture from every point of the lens.
        return np.c_[point, (position + forward * focus - point) / focus]
    return inputs, expect


@function("filter_offset", floor=1.0, strict=True)
def _():
    def inputs(rng):
        return np.c_[rng.integers(0, 2, N), units(rng, N, 2)]
    def expect(xs):
        u = xs[:, 1:]
        tent = np.where(u < 0.5, np.sqrt(2 * u) - 1, 1 - np.sqrt(2 - 2 * u))   # inverse of the tent's integral
        return np.where(xs[:, :1] == 0, u - 0.5, tent)
    return inputs, expect


def triangles(rng, n, spread=1.0):
    """24 numbers. Corners within `spread` of a point; vertex normals about the geometric one; any UV."""
    p = rng.normal(size=(n, 3, 3)) * spread + rng.normal(size=(n, 1, 3))
    normal = oracle.unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    normals = oracle.unit(normal[:, None] + 0.3 * rng.normal(size=(n, 3, 3)))
    return np.c_[p.reshape(n, 9), normals.reshape(n, 9), rng.uniform(-3, 3, (n, 6))]


@function("barycentric", groups=(2,), floor=1.0, loose=0.005, why="slivers: the area is a difference of products")
def _():
    def inputs(rng):
        xs = np.c_[triangles(rng, N), rng.normal(size=(N, 3))]
        xs[:3, 3:6] = xs[:3, :3]      # no area
        return xs
    return inputs, lambda xs: oracle.barycentric(xs[:, :3], xs[:, 3:6], xs[:, 6:9], xs[:, 24:27])


@function("uv_frame", groups=(3, 3, 3), floor=1.0, loose=0.005, why="slivers in space or UV: directions are differences of products")
def _():
    def inputs(rng):
        t = triangles(rng, N)
        t[:20, 20:22] = t[:20, 18:20]     # no UV area
        n = oracle.unit(np.cross(t[:, 3:6] - t[:, :3], t[:, 6:9] - t[:, :3]))
        return np.c_[t, oracle.unit(n + 0.3 * rng.normal(size=(N, 3)))]
    def expect(xs):
        """x along +u in the plane of the normal; y across it, on the side of +v."""
        p, t, n = xs[:, :9].reshape(-1, 3, 3), xs[:, 18:24].reshape(-1, 3, 2), xs[:, 24:27]
        d = np.stack([t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]], 1)
        e = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], 1)
        flat = (d[:, 0, 0] * d[:, 1, 1] - d[:, 1, 0] * d[:, 0, 1]) == 0
        jacobian = np.linalg.solve(np.where(flat[:, None, None], np.eye(2), d), e)      # rows dp/du, dp/dv
        x = jacobian[:, 0] - n * oracle.dot(n, jacobian[:, 0])[:, None]
        x = oracle.unit(x)
        handed = np.sign(oracle.dot(np.cross(jacobian[:, 0], jacobian[:, 1]), np.cross(e[:, 0], e[:, 1])))[:, None]
        frame = np.concatenate([x, np.cross(n, x) * handed, n], -1)
        return np.where(flat[:, None], oracle.frame(n).reshape(-1, 9), frame)
    return inputs, expect


@function("surface", groups=(3, 3, 3, 3, 3, 3, 2, 2, 2, 1), floor=1.0, loose=0.005, why="slivers and grazing rays")
def _():
    def inputs(rng):
        t = triangles(rng, N)
        p = t[:, :9].reshape(N, 3, 3)
        b = rng.dirichlet([1, 1, 1], N)
        on = np.einsum("nk,nkj->nj", b, p)
        n = oracle.unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
        away = sphere(rng, N)
        keep = np.abs(oracle.dot(away, n)) < 0.05
        away = np.where(keep[:, None], oracle.unit(away + n), away)
        eye = on + away * rng.uniform(0.5, 8, (N, 1))
        # The camera looks near the point, not at it: the direction's forward component is 1, not its length.
        forward = oracle.unit(oracle.unit(on - eye) + 0.2 * rng.normal(size=(N, 3)))
        d = on - eye
        d = d / oracle.dot(d, forward)[:, None]
        f = oracle.frame(forward)
        step = 10 ** rng.uniform(-4, -2, (N, 1))
        return np.c_[t, eye, d, f[:, 0] * step, f[:, 1] * -step]
    def expect(xs):
        p, normals, t = xs[:, :9].reshape(-1, 3, 3), xs[:, 9:18].reshape(-1, 3, 3), xs[:, 18:24].reshape(-1, 3, 2)
        origin, d, dx, dy = xs[:, 24:27], xs[:, 27:30], xs[:, 30:33], xs[:, 33:36]
        b, distance = oracle.intersect(p[:, 0], p[:, 1], p[:, 2], origin, d)
        # Where a neighbour's ray meets the plane, to first order: the exact intersection of a complex step.
        def tile_at(direction):
            b, _ = oracle.intersect(p[:, 0], p[:, 1], p[:, 2], origin, direction)
            return t[:, 0] + (t[:, 1] - t[:, 0]) * b[:, :1] + (t[:, 2] - t[:, 0]) * b[:, 1:]
        tile_dx, tile_dy = (np.clip(tile_at(d + 1e-20j * s).imag / 1e-20, -64, 64) for s in (dx, dy))
        front = oracle.unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
        behind = oracle.dot(d, front) > 0
        flip = np.where(behind, -1.0, 1.0)[:, None]
        wo = -oracle.unit(d)
        n = oracle.unit(normals[:, 0] * (1 - b.sum(-1))[:, None] + normals[:, 1] * b[:, :1] + normals[:, 2] * b[:, 1:])
        n = np.where((oracle.dot(n, front) < 0)[:, None], -n, n)
        n = np.where((oracle.dot(n, wo) * flip[:, 0] <= 1e-4)[:, None], front, n)
        frame = FUNCTIONS["uv_frame"].expect(np.c_[xs[:, :24], n]).reshape(-1, 3, 3)
        frame[:, 2] *= flip
        local = oracle.to_local(frame, wo)
        local[:, 2] = np.maximum(local[:, 2], 1e-6)
        return np.c_[origin + d * distance[:, None], front * flip, frame.reshape(-1, 9), local, tile_at(d), tile_dx, tile_dy, behind]
    return inputs, expect


@function("leave", groups=(3,), strict=True)
def _():
    def expect(xs):
        scale = np.maximum(np.abs(xs[:, :3]).max(-1), 1e-3)
        return xs[:, :3] + xs[:, 3:] * (scale * 2e-5)[:, None]
    return lambda rng: np.c_[rng.normal(size=(N, 3)) * 10 ** rng.uniform(-4, 3, (N, 1)), sphere(rng, N)], expect


# ---- cloth_light.h, cloth_direct.h ----------------------------------------------------------------------------------------------------

@function("environment_direction", groups=(3,), strict=True)
def _():
    return lambda rng: np.c_[units(rng, N, 2), rng.uniform(-7, 7, N)], lambda xs: oracle.environment_direction(xs[:, :2], xs[:, 2])


@function("environment_uv", floor=1.0, loose=0.005, why="u jumps at its seam")
def _():
    def inputs(rng):
        d = sphere(rng, N)
        d[:8] = [[0, 1, 0], [0, -1, 0], [0, 0, -1], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [1e-7, 1, 0], [0, -1, 1e-7]]
        return np.c_[oracle.unit(d), np.where(rng.random(N) < 0.5, 0, rng.uniform(-7, 7, N))]
    return inputs, lambda xs: oracle.environment_uv(xs[:, :3], xs[:, 3])


def environment_slack(xs):
    """GLSL leaves atan to the driver: Mesa's is off by some 30 units. Texels between which it falls differ by the image's range."""
    rounding = 40 * max(IMAGE.shape) * np.ptp(IMAGE[..., :3]) * xs[:, 8:11]
    return np.c_[rounding, np.zeros(len(xs))]


@function("environment", tables=True, floor=1e-3, loose=0.02, slack=environment_slack,
          why="the pdf jumps at texel edges; near the poles an azimuth is no longer told by x and z; GLSL's atan is approximate")
def _():
    def inputs(rng):
        return np.c_[lights_of_kind(rng, N, 0), sphere(rng, N)]
    return inputs, lambda xs: oracle.environment(IMAGE, xs[:, 19:22], xs[:, 17], xs[:, 8:11])


def emitter_points(lights, rng):
    """A point of some triangle of each light that is an object; anything for the others."""
    k = (lights[:, 17] + rng.random(len(lights)) * lights[:, 18]).astype(int)
    part = EMITTERS[np.where(lights[:, 0] == 6, np.minimum(k, len(EMITTERS) - 1), 0)].astype("f8")
    b = rng.random((len(lights), 2)) * 0.5
    return part[:, :3] + part[:, 3:6] * b[:, :1] + part[:, 6:9] * b[:, 1:]


def light_inputs(rng, directions):
    n = N // 7
    lights = np.concatenate([lights_of_kind(rng, n, kind) for kind in range(7)])
    position = rng.normal(size=(len(lights), 3)) * 3
    if directions:
        # Half of them aim at the light.
        aim_mesh = emitter_points(lights, rng)
        aim = lights[:, 2:5] + lights[:, 11:14] * rng.uniform(-1.3, 1.3, (len(lights), 1)) + lights[:, 14:17] * rng.uniform(-1.3, 1.3, (len(lights), 1))
        aim = np.where(lights[:, :1] == 6, aim_mesh, aim)
        d = np.where(rng.random((len(lights), 1)) < 0.5, oracle.unit(aim - position), sphere(rng, len(lights)))
        return np.c_[lights, position, d]
    position[:3] = lights[:3, 2:5]
    u = units(rng, len(lights), 2)
    # At a texel's very edge the pdf is that of either texel.
    u = np.where(lights[:, :1] == 0, np.clip(u, 0.01, 0.99), u)
    return np.c_[lights, position, u, words(rng, len(lights)), words(rng, len(lights))]


def no_light(n):
    return np.c_[np.zeros((n, 2)), np.ones(n), np.full(n, 1e30), np.zeros((n, 4))]


def light_slack(xs):
    return np.where(xs[:, :1] == 0, np.c_[np.zeros((len(xs), 4)), environment_slack(xs)], 0)


@function("light_sample", tables=True, groups=(3, 1, 3, 1), loose=0.005, slack=light_slack, why="as environment; cones and penumbrae are differences of cosines near 1")
def _():
    def expect(xs):
        out = no_light(len(xs))
        kind, position, axis, radiance, e_u, e_v = xs[:, 0], xs[:, 2:5], xs[:, 5:8], xs[:, 8:11], xs[:, 11:14], xs[:, 14:17]
        at, u = xs[:, 19:22], xs[:, 22:24]
        h, w = IMAGE.shape[:2]
        # environment: the shares of the rows inverted, then those of the row's texels
        env = kind == 0
        ends = TABLES.inversion.reshape(-1, 2)[:, 0].astype(np.int64)
        def invert(ends, bits, rest):   # ends of each sample's own shares
            at = np.minimum((ends <= bits[:, None]).sum(1), ends.shape[1] - 1)
            end, begin = (np.take_along_axis(np.c_[np.zeros(len(ends), np.int64), ends], at[:, None] + k, 1)[:, 0] for k in (1, 0))
            return at, np.minimum((bits - begin + rest) / np.maximum(end - begin, 1), 1 - 2**-24)
        row, v = invert(np.broadcast_to(ends[w * h:w * h + h], (len(xs), h)), word(xs, 26).astype(np.int64), u[:, 1])
        column, u_in = invert(ends[:w * h].reshape(h, w)[row], word(xs, 24).astype(np.int64), u[:, 0])
        uv = np.c_[(column + u_in) / w, (row + v) / h]
        d = oracle.unit(oracle.environment_direction(uv, xs[:, 17]))
        seen = oracle.environment(IMAGE, d, xs[:, 17], radiance)
        out[env] = np.c_[d, np.full(len(xs), 1e30), seen][env]
        # sun: uniform in its cone, radiance E / (pi sin^2)
        sun, x_max = kind == 1, xs[:, 17]
        cosine = 1 - x_max * u[:, 0]
        sine = np.sqrt(np.maximum(0, x_max * u[:, 0] * (2 - x_max * u[:, 0])))
        phi = 2 * np.pi * u[:, 1]
        d = oracle.to_world(oracle.frame(oracle.unit(axis)), np.c_[sine * np.cos(phi), sine * np.sin(phi), cosine])
        solid = np.where(x_max > 0, x_max, 1)
        wide = np.c_[d, np.full(len(xs), 1e30), radiance / (np.pi * solid * (2 - solid))[:, None], 1 / (2 * np.pi * solid)]
        narrow = np.c_[axis, np.full(len(xs), 1e30), radiance, np.ones(len(xs))]
        out[sun] = np.where((x_max > 0)[:, None], wide, narrow)[sun]
        # the others have a place
        target = np.where((kind == 4)[:, None], position + e_u * (2 * u[:, :1] - 1) + e_v * (2 * u[:, 1:] - 1), position)
        to = target - at
        distance = np.sqrt(oracle.dot(to, to))
        reached = distance > 1e-10
        distance = np.where(reached, distance, 1)
        d = to / distance[:, None]
        cosine = -oracle.dot(d, axis)
        area = 4 * np.linalg.norm(np.cross(e_u, e_v), axis=1)
        # an object: a triangle of the alias table, a point of it uniform in area
        mesh = kind == 6
        first, count = xs[:, 17].astype(np.int64), np.where(mesh, xs[:, 18], 1).astype(np.uint64)
        column = ((word(xs, 24).astype(np.uint64) * count) >> np.uint64(32)).astype(np.int64)
        rows = EMITTERS[np.where(mesh, first + column, 0)]
        threshold, other = word(rows, 9), word(rows, 11).astype(np.int64)
        rows = EMITTERS[np.where(mesh, first + np.where(word(xs, 26) >= threshold, other, column), 0)].astype("f8")
        b = np.sqrt(u[:, :1])
        to_m = rows[:, :3] + rows[:, 3:6] * (1 - b) + rows[:, 6:9] * (b * u[:, 1:]) - at
        far = np.linalg.norm(to_m, axis=1)
        d_m, n_m = to_m / far[:, None], oracle.unit(np.cross(rows[:, 3:6], rows[:, 6:9]))
        cos_m = -oracle.dot(d_m, n_m)
        seen = mesh & (cos_m > 1e-6)
        out[seen] = np.c_[d_m, far, radiance, far**2 / (np.where(cos_m > 0, cos_m, 1) * np.where(mesh, xs[:, 11], 1))][seen]
        lit = (kind == 4) & reached & (cosine > 0)
        out[lit] = np.c_[d, distance, radiance, distance**2 / (np.where(cosine > 0, cosine, 1) * area)][lit]
        x = np.clip((cosine - xs[:, 17]) / np.maximum(xs[:, 18] - xs[:, 17], 1e-6), 0, 1)
        lobe = np.select([kind == 5, kind == 3], [np.maximum(cosine, 0), x * x * (3 - 2 * x)], 1.0)
        near = ((kind == 2) | (kind == 3) | (kind == 5)) & reached
        out[near] = np.c_[d, distance, radiance * (lobe / distance**2)[:, None], lobe > 0][near]
        return out
    return lambda rng: light_inputs(rng, False), expect


@function("light_hit", tables=True, groups=(3, 1, 3, 1), loose=0.005, slack=light_slack, why="as environment; rectangles, triangles and the sun have edges, and grazing ones are far")
def _():
    def expect(xs):
        out = no_light(len(xs))
        kind, position, axis, radiance, e_u, e_v = xs[:, 0], xs[:, 2:5], xs[:, 5:8], xs[:, 8:11], xs[:, 11:14], xs[:, 14:17]
        at, d = xs[:, 19:22], xs[:, 22:25]
        env = kind == 0
        out[env] = np.c_[d, np.full(len(xs), 1e30), oracle.environment(IMAGE, d, xs[:, 17], radiance)][env]
        sun = (kind == 1) & (xs[:, 17] > 0) & (2 * np.arcsin(np.minimum(np.linalg.norm(d - axis, axis=1) / 2, 1)) <= np.arccos(1 - xs[:, 17]))
        solid = np.where(xs[:, 17] > 0, xs[:, 17], 1)
        out[sun] = np.c_[d, np.full(len(xs), 1e30), radiance / (np.pi * solid * (2 - solid))[:, None], 1 / (2 * np.pi * solid)][sun]
        for row in np.flatnonzero(kind == 6):
            part = EMITTERS[int(xs[row, 17]):int(xs[row, 17] + xs[row, 18])].astype("f8")
            b, t = oracle.intersect(part[:, :3], part[:, :3] + part[:, 3:6], part[:, :3] + part[:, 6:9], at[row], np.broadcast_to(d[row], (len(part), 3)))
            t = np.where((b >= 0).all(1) & (b.sum(1) <= 1) & (t > 0), t, np.inf)
            nearest = t.argmin()
            facing = -d[row] @ oracle.unit(np.cross(part[nearest, 3:6], part[nearest, 6:9]))
            if np.isfinite(t[nearest]) and facing > 1e-6:
                out[row] = np.r_[d[row], t[nearest], radiance[row], t[nearest] ** 2 / (facing * xs[row, 11])]
        cosine = -oracle.dot(d, axis)
        safe = np.where(np.abs(cosine) > 1e-9, cosine, 1)
        distance = -oracle.dot(position - at, axis) / safe
        on = at + d * distance[:, None] - position
        inside = (np.abs(oracle.dot(on, e_u)) <= oracle.dot(e_u, e_u)) & (np.abs(oracle.dot(on, e_v)) <= oracle.dot(e_v, e_v))
        hit = (kind == 4) & (cosine > 1e-6) & (distance > 0) & inside
        area = 4 * np.linalg.norm(np.cross(e_u, e_v), axis=1)
        out[hit] = np.c_[d, distance, radiance, distance**2 / (safe * np.where(area > 0, area, 1))][hit]
        return out
    return lambda rng: light_inputs(rng, True), expect


@function("least", strict=True)
def _():
    def inputs(rng):
        brings = np.where(rng.random(N) < .1, 0, 10 ** rng.uniform(-35, 8, N))
        return np.c_[brings, brings + np.where(rng.random(N) < .3, 0, 10 ** rng.uniform(-8, 8, N))]
    def expect(xs):
        brings, every = xs.T
        least = .25 * every / np.where(brings > 0, brings, 1)
        return np.where((brings > 0) & (least < 1e30), least, 0)[:, None]
    return inputs, expect


@function("shadow_roulette", loose=0.005, why="a choice at its edge falls either way")
def _():
    def inputs(rng):
        least = np.where(rng.random(N) < .2, 0, 10 ** rng.uniform(-3, .5, N))
        return np.c_[rng.random(N) * rng.integers(0, 5, N).clip(0, 1) * 1.2, units(rng, N, 1), least]
    def expect(xs):
        left, u, least = xs.T
        falls = left < least
        p = np.where(falls, left / np.where(falls, least, 1), 1)
        return np.c_[np.where(falls, np.where(u < p, least, 0), left), np.where(u < p, u / np.where(p > 0, p, 1), u)]
    return inputs, expect


@function("ask_light", tables=True, floor=1.0, loose=0.005, why="a choice at its edge falls either way")
def _():
    def inputs(rng):
        slots = rng.integers(1, 8, N)   # 7 lights
        return np.c_[units(rng, N, 1), rng.integers(0, slots), slots]
    def expect(xs):
        out = []
        for u, slot, slots in xs:
            pmf = TABLES.lights[int(slot):, 1].astype("f8")
            if slot + 1 < slots or len(pmf) == 1:   # asked for certain
                out.append([TABLES.lights[int(slot), 0], u, 1])
                continue
            share = pmf / (1 - TABLES.lights[:int(slot), 1].astype("f8").sum())   # all of them add up to 1, but for their rounding
            edge = np.r_[0, np.cumsum(share)]
            k = min(np.searchsorted(edge, u, "right") - 1, len(pmf) - 1)
            out.append([TABLES.lights[int(slot) + k, 0], np.clip((u - edge[k]) / share[k], 0, np.float32(0.99999994)), share[k]])
        return np.array(out)
    return inputs, expect


# ---- color.h, random.h ------------------------------------------------------------------------------------------------------------------

def colours(rng):
    c = 10 ** rng.uniform(-5, 4, (N, 3))
    c[:6] = [[0, 0, 0], [0.08, 0.08, 0.08], [0.8, 0.8, 0.8], [1e6, 0, 0], [0.04, 0.9, 0.1], [0, 0, 1e-8]]
    return c


@function("tone_neutral", floor=1e-5, groups=(3,), strict=True)
def _():
    return colours, oracle.tone_neutral


@function("srgb", strict=True)
def _():
    return lambda rng: np.r_[[[0, 0.0031308, 0.0031309], [1, 1e-9, 0.5]], rng.random((N, 3))], oracle.srgb


@function("display", groups=(3,), floor=1e-4, strict=True)
def _():
    def expect(xs):
        return oracle.srgb(oracle.tone_neutral(np.maximum(xs[:, :3], 0) * 2.0 ** xs[:, 3:]))
    def inputs(rng):
        c = colours(rng)
        c[10:20, 0] = -1
        return np.c_[c, rng.uniform(-4, 4, N)]
    return inputs, expect


@function("relmse_term", strict=True)
def _():
    def inputs(rng):
        b = 10 ** rng.uniform(-4, 3, N)
        return np.c_[b * (1 + rng.normal(size=N) * 10 ** rng.uniform(-3, 0, N)), b]
    return inputs, lambda xs: (xs[:, 0] - xs[:, 1]) ** 2 / (xs[:, 1] ** 2 + 0.01)


def seeds(rng, count):
    n = 1000
    return np.concatenate([words(rng, n) for _ in range(count)], 1)


@function("hash", exact=True)
def _():
    return lambda rng: seeds(rng, 1), lambda xs: halves([oracle.hash32(x) for x in word(xs, 0)])


@function("hash_combine", exact=True)
def _():
    return lambda rng: seeds(rng, 2), lambda xs: halves([oracle.hash_combine(int(a), int(b)) for a, b in zip(word(xs, 0), word(xs, 2))])


def draws(rng):
    xs = seeds(rng, 3)
    xs[:500, 2:4] = halves(np.arange(500))      # the indices that occur: 0, 1, 2, ...
    xs[:, 4:6] = halves(rng.integers(0, 64, len(xs)))
    return xs


def drawn(xs):
    return np.array([oracle.random_bits(int(a), int(b), int(c)) for a, b, c in zip(word(xs, 0), word(xs, 2), word(xs, 4))])


@function("random_bits", exact=True)
def _():
    return draws, lambda xs: halves(drawn(xs)).reshape(-1, 4)


@function("random", exact=True)
def _():
    return draws, lambda xs: (drawn(xs) >> 8) / 2**24


@function("block_length", exact=True)
def _():
    return lambda rng: halves(np.r_[0:2100, 2**20, 2**32 - 1]), lambda xs: np.array([oracle.block_length(int(x)) for x in word(xs, 0)], float)
