"""Samplers follow their densities, densities integrate to 1, and no point gives back more light than it receives."""
import dataclasses
import functools

import numpy as np
import pytest
from scipy import stats

import cloth_oracle as oracle
import evaluate
import shared_functions

SAMPLES = 100_000
# One chance in 10,000 for each verdict to be wrong, and the seeds are fixed: what passes once passes always.
SIGNIFICANCE = 1e-4


def sphere_cells(rows, columns, sub):
    """Directions at the midpoints of sub x sub parts of each cell of equal solid angle: (rows, columns, sub * sub, 3). The
    number of rows is odd, so that the horizon is no cell's edge."""
    assert rows % 2 == 1
    z = -1 + 2 * (np.arange(rows * sub) + 0.5) / (rows * sub)
    phi = -np.pi + 2 * np.pi * (np.arange(columns * sub) + 0.5) / (columns * sub)
    z, phi = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1 - z * z)
    d = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)
    return d.reshape(rows, sub, columns, sub, 3).swapaxes(1, 2).reshape(rows, columns, sub * sub, 3)


QUADRATURE = sphere_cells(201, 300, 1).reshape(-1, 3)


def chi_square(directions, density, rows=31, columns=48, sub=8):
    """p-value of directions having the density [1/sr], integrated over cells; total mass of the density."""
    cells = sphere_cells(rows, columns, sub)
    mass = density(cells.reshape(-1, 3)).reshape(rows, columns, -1).mean(-1) * 4 * np.pi / (rows * columns)
    expected = mass * len(directions)
    seen = np.histogram2d(directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0]), (rows, columns), ((-1, 1), (-np.pi, np.pi)))[0]
    # Cells that expect less than 10 are pooled.
    small = expected < 10
    expected_all = np.append(expected[~small], expected[small].sum())
    seen_all = np.append(seen[~small], len(directions) - seen[~small].sum())
    if expected_all[-1] < 10:
        assert seen_all[-1] < 40, f"{seen_all[-1]:.0f} samples where {expected_all[-1]:.2g} are expected"
        expected_all, seen_all = expected_all[:-1], seen_all[:-1]
    statistic = ((seen_all - expected_all) ** 2 / expected_all).sum()
    return stats.chi2.sf(statistic, len(expected_all) - 1), mass.sum()


def stratified(rng, n):
    """Jittered points in the unit square: the noise of the tests is not worse than it must be."""
    return rng.random((n, 2))


def tile(row, n):
    return np.broadcast_to(row, (n, len(row)))


VIEWS = [oracle.unit(np.array(o)) for o in ([0.0, 0.0, 1.0], [0.5, -0.2, 0.6], [-0.9, 0.3, 0.15])]
TANGENTS = [oracle.unit(np.array(t)) for t in ([1.0, 0.0, 0.0], [0.3, 1.0, -0.4])]


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6, 1.0])
@pytest.mark.parametrize("tangent", TANGENTS, ids=["along_x", "tilted"])
def test_flake_normals_follow_their_density(alpha, tangent, build, evaluator):
    """Sampled normals against D_w(m), which math.md 2.1 defines and the sampler never evaluates."""
    rng = np.random.default_rng(11)
    for w in VIEWS:
        m = evaluator.run(build, "sggx_sample_vndf", np.c_[tile(np.r_[w, tangent, alpha], SAMPLES), stratified(rng, SAMPLES)])
        assert np.abs(np.linalg.norm(m, axis=1) - 1).max() < 1e-5
        assert (m @ w).min() > -1e-6, "a flake that is seen from behind"
        # The fibre along z: the density depends on z slowly there, and no cell holds all of it.
        f = oracle.frame(tangent)
        p, mass = chi_square(oracle.to_local(f, m), lambda h: oracle.sggx_d_w(w, oracle.to_world(f, h), tangent, alpha), sub=16)
        assert abs(mass - 1) < 2e-3
        assert p > SIGNIFICANCE, f"w {w}: p = {p:.2g}"


def test_cosine_samples_follow_their_density(build, evaluator):
    rng = np.random.default_rng(12)
    n = oracle.unit(np.array([0.4, -0.7, -0.3]))
    d = evaluator.run(build, "cosine_sample", np.c_[tile(n, SAMPLES), stratified(rng, SAMPLES)])
    p, mass = chi_square(d, lambda w: np.maximum(w @ n, 0) / np.pi)
    assert abs(mass - 1) < 1e-3 and p > SIGNIFICANCE


def make_point(slope_f, slope_b, azimuth, twist):
    n_f, n_b = np.r_[-np.array(slope_f), 1.0], np.r_[-np.array(slope_b), 1.0]
    t = oracle.unit(np.array([np.cos(azimuth), np.sin(azimuth), slope_f[0] * np.cos(azimuth) + slope_f[1] * np.sin(azimuth)]))
    t = np.cos(twist) * t + np.sin(twist) * np.cross(oracle.unit(n_f), t)
    return np.r_[oracle.unit(n_f), oracle.unit(n_b), t, np.linalg.norm(n_f), np.linalg.norm(n_b)]


def make_yarn(a_r, a_t, kd_r, kd_t, alpha_r, alpha_t, thickness, mix):
    return np.r_[[a_r] * 3, [a_t] * 3, [kd_r] * 3, [kd_t] * 3, alpha_r, alpha_t, thickness, 0.0, mix]


FLAT, TILTED = make_point([0, 0], [0, 0], 0.3, 0.2), make_point([0.8, -0.5], [-0.6, 0.4], 1.9, -0.4)
POINTS = {"flat": FLAT, "tilted": TILTED}
# Each lobe alone, then all together: a wrong selection probability shows only in the mixture.
YARNS = {
    "reflection": make_yarn(0.7, 0, 0, 0, 0.3, 0.3, 1.5, 1),
    "transmission": make_yarn(0, 0.7, 0, 0, 0.3, 0.2, 0.5, 1),
    "diffuse_reflection": make_yarn(0, 0, 0.5, 0, 0.3, 0.3, 1.5, 0.6),
    "diffuse_transmission": make_yarn(0, 0, 0, 0.5, 0.3, 0.3, 1.5, 0.6),
    "all": make_yarn(0.4, 0.2, 0.3, 0.1, 0.15, 0.4, 1.5, 0.7),
}
VIEW = oracle.unit(np.array([0.5, 0.2, 0.8]))


def point_rows(point, yarn, i, o):
    return np.c_[tile(np.r_[point, yarn], len(i)), i, tile(o, len(i))]


def value_rows(point, yarn, i, o):
    """For point_value, with the slab's cosines about the ply normal."""
    return np.c_[point_rows(point, yarn, i, o), np.zeros(len(i))]


def sample_point(evaluator, build, point, yarn, o, seed, n=SAMPLES):
    rng = np.random.default_rng(seed)
    s = evaluator.run(build, "point_sample", np.c_[tile(np.r_[point, yarn, o], n), stratified(rng, n), stratified(rng, n)])
    return s[:, :3], s[:, 3]


@pytest.mark.parametrize("yarn", YARNS)
@pytest.mark.parametrize("point", POINTS)
def test_point_samples_follow_their_pdf(point, yarn, build, evaluator):
    point, yarn = POINTS[point], YARNS[yarn]
    i, pdf = sample_point(evaluator, build, point, yarn, VIEW, 13)
    assert (pdf > 0).all()
    claimed = evaluator.run(build, "point_pdf", point_rows(point, yarn, i, VIEW))[:, 0]
    assert np.allclose(claimed, pdf, rtol=1e-9 if build == "f64" else 1e-3), "sample and pdf disagree about the density"
    p, mass = chi_square(i, lambda w: evaluator.run(build, "point_pdf", point_rows(point, yarn, w, VIEW))[:, 0])
    assert abs(mass - 1) < 2e-3, f"the pdf integrates to {mass:.5f}"
    assert p > SIGNIFICANCE, f"p = {p:.2g}"


@pytest.mark.parametrize("point", POINTS)
def test_samples_of_a_yarn_beneath_follow_their_pdf(point, build, evaluator):
    """Where another yarn bends what passes, its fibres run another way than those that reflect."""
    def run(i, u):
        rest = np.r_[0, oracle.unit(np.array([0.3, 1, -0.4])), 2.5]   # slab's cosines of the ply, fibre tangent, thickness
        return evaluator.run(build, "point_beneath", np.c_[point_rows(POINTS[point], YARNS["all"], i, VIEW), tile(rest, len(i)), u])
    rng = np.random.default_rng(15)
    s = run(tile(VIEW, SAMPLES), np.c_[stratified(rng, SAMPLES), stratified(rng, SAMPLES)])
    i, pdf = s[:, 4:7], s[:, 7]
    assert (pdf > 0).all()
    assert np.allclose(run(i, np.full((len(i), 4), .5))[:, 3], pdf, rtol=1e-9 if build == "f64" else 1e-3)
    p, mass = chi_square(i, lambda w: run(w, np.full((len(w), 4), .5))[:, 3])
    assert abs(mass - 1) < 2e-3 and p > SIGNIFICANCE, (mass, p)


@pytest.mark.parametrize("yarn", YARNS)
@pytest.mark.parametrize("point", POINTS)
def test_sample_weights_give_the_integral_of_the_value(point, yarn, build, evaluator, record_property):
    """Mean of value / pdf against quadrature; the spread is recorded and bounded, since a wrong selection probability leaves the
    mean as it is and only spoils the spread."""
    point, yarn = POINTS[point], YARNS[yarn]
    i, pdf = sample_point(evaluator, build, point, yarn, VIEW, 14)
    weight = evaluator.run(build, "point_value", value_rows(point, yarn, i, VIEW))[:, 0] / pdf
    cells = QUADRATURE
    integral = evaluator.run(build, "point_value", value_rows(point, yarn, cells, VIEW))[:, 0].mean() * 4 * np.pi
    deviation = weight.std() / np.sqrt(len(weight))
    record_property("weight_deviation", float(weight.std()))
    record_property("integral", float(integral))
    assert abs(weight.mean() - integral) < 4 * deviation + 1e-3 * integral
    assert weight.std() < 0.6, f"weights scatter by {weight.std():.2f} about {integral:.2f}"
    assert weight.max() < 3


# ---- slab against physics ------------------------------------------------------------------------------------------------------

SLAB_CASES = [   # alpha, T, o, t
    (1.0, 1.0, [0, 0, 1], [1, 0, 0]),
    (0.3, 1.0, [0.3, 0, 0.95], [1, 0.2, 0.1]),
    (0.3, 3.0, [0.5, 0.3, 0.8], [0.3, 1, 0]),
    (0.1, 2.0, [0, 0.95, 0.31], [1, 0, 0]),
    (0.2, 0.5, [0.7, 0.1, 0.5], [1, 0.5, 0.3]),
]


def slab_directional(evaluator, build, alpha, thickness, o, t):
    """R1 and T1 = integral of K / c_o over the two hemispheres, about n = z."""
    i = QUADRATURE
    d = evaluator.run(build, "sggx_d_half", np.c_[i, tile(np.r_[o, t, alpha], len(i))])
    s_i = evaluator.run(build, "sggx_sigma", np.c_[i, tile(np.r_[t, alpha], len(i))])
    s_o = evaluator.run(build, "sggx_sigma", np.r_[o, t, alpha])[0, 0]
    rows = np.c_[d, s_i, tile([s_o], len(i)), np.abs(i[:, 2]), tile([o[2], thickness], len(i))]
    k_r, k_t = (evaluator.run(build, name, rows)[:, 0] / o[2] for name in ("slab_reflect", "slab_transmit"))
    return np.where(i[:, 2] > 0, k_r, 0).mean() * 4 * np.pi, np.where(i[:, 2] < 0, k_t, 0).mean() * 4 * np.pi


@functools.cache
def flake_slab(alpha, thickness, o, t, photons):
    """Photons through a slab of flakes: those that leave upward and downward after one collision, and unscattered. Knows flight
    lengths and mirrors, no formula of math.md 3."""
    rng = np.random.default_rng(15)
    o, t = tile(oracle.unit(np.array(o, float)), photons), tile(oracle.unit(np.array(t, float)), photons)
    depth = rng.exponential(size=photons) * o[:, 2] / oracle.sggx_sigma(o, t, alpha)
    through = depth > thickness
    m = oracle.sggx_sample_vndf(o, t, np.full(photons, alpha), rng.random((photons, 2)))
    i = 2 * oracle.dot(o, m)[:, None] * m - o
    way = np.where(i[:, 2] > 0, depth, thickness - depth) / np.maximum(np.abs(i[:, 2]), 1e-12)
    leaves = ~through & (rng.exponential(size=photons) > way * oracle.sggx_sigma(i, t, alpha))
    return (leaves & (i[:, 2] > 0)).mean(), (leaves & (i[:, 2] < 0)).mean(), through.mean()


@pytest.mark.parametrize("alpha, thickness, o, t", SLAB_CASES)
def test_slab_agrees_with_photons(alpha, thickness, o, t, build, evaluator):
    photons = 1_000_000
    counted = flake_slab(alpha, thickness, tuple(o), tuple(t), photons)
    o, t = oracle.unit(np.array(o, float)), oracle.unit(np.array(t, float))
    r_1, t_1 = slab_directional(evaluator, build, alpha, thickness, o, t)
    u = oracle.unscattered(oracle.sggx_sigma(o, t, alpha), o[2], thickness)
    for name, closed, seen in zip(("R1", "T1", "U"), (r_1, t_1, u), counted):
        assert abs(closed - seen) < 4 * np.sqrt(closed / photons) + 2e-4, f"{name}: closed form {closed:.5f}, photons {seen:.5f}"
    assert r_1 + t_1 + u < 1


def test_slab_of_isotropic_flakes_has_the_known_values(build, evaluator):
    """math.md 3.3 and 11: alpha = 1, T = 1, normal incidence."""
    r_1, t_1 = slab_directional(evaluator, build, 1.0, 1.0, np.array([0, 0, 1.0]), np.array([1.0, 0, 0]))
    assert np.isclose(r_1, 0.142015, rtol=2e-4) and np.isclose(t_1, 0.106173, rtol=2e-4)


@pytest.mark.parametrize("row", ["slab_reflect", "slab_transmit"])
def test_slabs_are_reciprocal(row, build, evaluator):
    rng = np.random.default_rng(16)
    n = 20_000
    i, o, t = (shared_functions.sphere(rng, n) for _ in range(3))
    alpha, thickness = shared_functions.alphas(rng, n), 10 ** rng.uniform(-1, 1, n)
    def k(i, o):
        d = evaluator.run(build, "sggx_d_half", np.c_[i, o, t, alpha])
        s_i, s_o = (evaluator.run(build, "sggx_sigma", np.c_[w, t, alpha]) for w in (i, o))
        return evaluator.run(build, row, np.c_[d, s_i, s_o, np.abs(i[:, 2]), np.abs(o[:, 2]), thickness])[:, 0]
    forth, back = k(i, o), k(o, i)
    assert np.allclose(forth, back, rtol=1e-12 if build == "f64" else 2e-5, atol=1e-25)


@pytest.mark.parametrize("alpha", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("thickness", [0.3, 2.0, 8.0])
def test_no_point_gives_back_more_than_it_receives(alpha, thickness, build, evaluator):
    """Integral of F over the sphere for an albedo of 1 without a diffuse part, and with a + kd = 1 [4.2, 6.6]; back normals are
    mirror images of the front's, w = 1, everything visible."""
    cells = sphere_cells(101, 128, 1).reshape(-1, 3)
    for slope in ([0, 0], [0.5, 0.3], [-1.2, 0.8], [3, -2]):
        point = make_point(slope, [-slope[0], -slope[1]], 0.7, 0.3)
        for a, kd in ((1.0, 0.0), (0.5, 0.25)):
            yarn = make_yarn(a, a, kd, kd, alpha, alpha, thickness, 1.0)
            for o in VIEWS:
                if point[:3] @ o <= 0:
                    continue
                total = evaluator.run(build, "point_value", value_rows(point, yarn, cells, o))[:, 0].mean() * 4 * np.pi
                assert 0 <= total <= 1.002, f"slope {slope}, o {o}, albedo {a}: {total:.4f}"


# ---- lights ------------------------------------------------------------------------------------------------------------------------

def tables_with(environment):
    return dataclasses.replace(shared_functions.TABLES, environment=environment.astype("f4"),
                               inversion=evaluate.inversion_table(environment[..., 3]))


SKY = shared_functions.IMAGE.astype("f4").astype("f8")
SKY_TABLES = tables_with(SKY)


def light_row(kind, position=(0, 0, 0), axis=(0, 1, 0), radiance=(1, 1, 1), edge_u=(0, 0, 0), edge_v=(0, 0, 0), shape=(0, 0)):
    return np.r_[kind, 1.0, position, axis, radiance, edge_u, edge_v, shape].astype(float)


def sample_light(evaluator, build, light, position, seed, n=SAMPLES):
    rng = np.random.default_rng(seed)
    return evaluator.run(build, "light_sample", np.c_[tile(np.r_[light, position], n), stratified(rng, n), shared_functions.words(rng, n),
                                                      shared_functions.words(rng, n)], SKY_TABLES)


def hit_light(evaluator, build, light, position, directions):
    return evaluator.run(build, "light_hit", np.c_[tile(np.r_[light, position], len(directions)), directions], SKY_TABLES)


def test_environment_samples_follow_their_pdf(build, evaluator):
    light = light_row(0, shape=(0.7, 0))
    s = sample_light(evaluator, build, light, [0, 0, 0], 17)
    # y is the pole of the map: it becomes the pole of the cells.
    def density(d):
        return hit_light(evaluator, build, light, [0, 0, 0], d[:, [0, 2, 1]])[:, 7]
    p, mass = chi_square(s[:, [0, 2, 1]], density, sub=24)
    assert p > SIGNIFICANCE, (mass, p)
    # In the map's own coordinates, where 1 / sin(theta) does no harm, the pdf integrates to 1 to many digits.
    h, w = SKY.shape[:2]
    v, u = np.meshgrid((np.arange(h * 64) + 0.5) / (h * 64), (np.arange(w * 4) + 0.5) / (w * 4), indexing="ij")
    uv = np.stack([u, v], -1).reshape(-1, 2)
    pdf = hit_light(evaluator, build, light, [0, 0, 0], oracle.environment_direction(uv, 0.7))[:, 7]
    assert abs((pdf * 2 * np.pi**2 * np.sin(np.pi * uv[:, 1])).mean() - 1) < 1e-4
    sky = hit_light(evaluator, build, light, [0, 0, 0], QUADRATURE[:, [0, 2, 1]])[:, 4].mean() * 4 * np.pi
    weight = s[:, 4] / s[:, 7]
    assert abs(weight.mean() - sky) < 4 * weight.std() / np.sqrt(len(weight)) + 1e-3 * sky


RECTANGLE = light_row(4, position=(0.3, 2, -0.2), axis=(0, -1, 0), edge_u=(0.8, 0, 0), edge_v=(0, 0, 0.5))


def test_rectangle_samples_follow_their_pdf(build, evaluator):
    at = np.array([0.1, 0.2, 0.5])
    s = sample_light(evaluator, build, RECTANGLE, at, 18)
    again = hit_light(evaluator, build, RECTANGLE, at, s[:, :3])
    inside = again[:, 7] > 0      # a sample on the very edge may round to the outside
    assert inside.mean() > 0.9999
    assert np.allclose(again[inside, 7], s[inside, 7], rtol=1e-9 if build == "f64" else 1e-4)
    assert np.allclose(again[inside, 3], s[inside, 3], rtol=1e-9 if build == "f64" else 1e-5)
    mass = hit_light(evaluator, build, RECTANGLE, at, sphere_cells(301, 600, 1).reshape(-1, 3))[:, 7].mean() * 4 * np.pi
    assert abs(mass - 1) < 0.01      # the edge crosses cells


def test_rectangle_gives_the_irradiance_of_its_form_factor(build, evaluator):
    """A point under the corner of a parallel rectangle a x b at height h: E = L/2 (A/sqrt(1+A^2) atan(B/sqrt(1+A^2)) + ...), Lambert
    1760; four of them meet under an inner point."""
    at = np.array([0.1, 0.2, -0.1])
    s = sample_light(evaluator, build, RECTANGLE, at, 19)
    estimate = s[:, 4] * np.maximum(s[:, 1], 0) / s[:, 7]
    def corner(a, b, h):
        a, b = a / h, b / h
        ra, rb = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
        return 0.5 * (a / ra * np.arctan(b / ra) + b / rb * np.arctan(a / rb))
    h = 1.8
    xs, zs = (0.3 + 0.8 - 0.1, 0.8 - 0.3 + 0.1), (-0.2 + 0.5 + 0.1, 0.5 + 0.2 - 0.1)
    exact = sum(corner(x, z, h) for x in xs for z in zs)
    assert abs(estimate.mean() - exact) < 4 * estimate.std() / np.sqrt(len(estimate)) + 1e-5


def test_sun_gives_its_irradiance(build, evaluator):
    x = 1 - np.cos(np.radians(0.53 / 2))
    axis = oracle.unit(np.array([0.3, 0.8, -0.4]))
    s = sample_light(evaluator, build, light_row(1, axis=axis, radiance=(3, 2, 1), shape=(x, 0)), [0, 0, 0], 20)
    assert (1 - s[:, :3] @ axis).max() < x * 1.001 + 2e-7
    estimate = s[:, 4] * (s[:, :3] @ axis) / s[:, 7]
    assert abs(estimate.mean() - 3) < 1e-4


# ---- sequences ---------------------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("dimension", [0, 3, 20])
def test_points_form_a_net(dimension, build, evaluator):
    """The first 2^m points have one in each elementary interval 2^-k x 2^-(m-k): the (0, 2) property, scrambled or not."""
    for m in (4, 6):
        for seed in (1, 0xdeadbeef):
            n = 2**m
            bits = shared_functions.halves(np.c_[np.full(n, seed), np.arange(n), np.full(n, dimension)]).reshape(n, 6)
            u = evaluator.run(build, "random", bits)
            for k in range(m + 1):
                cell = np.floor(u[:, 0] * 2**k) * 2 ** (m - k) + np.floor(u[:, 1] * 2 ** (m - k))
                assert len(set(cell)) == n


def test_dimensions_and_seeds_are_independent(build, evaluator):
    """Correlation of any two of: neighbouring pixels' seeds, neighbouring dimensions, x and y. 4 sigma for each of many pairs."""
    n = 4096
    series = []
    for seed in (oracle.hash_combine(1, 7), oracle.hash_combine(1, 8)):
        for dimension in range(4):
            # One point of each block: inside a block points repel each other by design.
            seeds = [oracle.hash_combine(seed, block) for block in range(n)]
            bits = shared_functions.halves(np.c_[seeds, np.zeros(n, int), np.full(n, dimension)]).reshape(n, 6)
            series += list(evaluator.run(build, "random", bits).T)
    correlation = np.corrcoef(series) - np.eye(len(series))
    assert np.abs(correlation).max() < 5 / np.sqrt(n)
    assert all(stats.kstest(x, "uniform").pvalue > SIGNIFICANCE for x in series)
