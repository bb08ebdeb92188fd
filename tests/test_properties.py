"""Laws that the shared functions keep whatever the input, sought by hypothesis, which shrinks what breaks one. C++ float and double;
one process answers all calls.

Seen red: with the slab's thickness on one side only (reciprocity, energy), the frame without its sign (n.z = -1), 1/2 for 1/4 in the
slab (energy)."""
import subprocess

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from bench import stability

SETTINGS = hypothesis.settings(max_examples=100, deadline=None, derandomize=True, database=None,
                               suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture, hypothesis.HealthCheck.too_slow])
UP = np.array([0.0, 0.0, 1.0])
ENVIRONMENT = np.array([32, 16])   # texels of the one in tests/cpp/stability_inputs.cpp


class Server:
    def __init__(self):
        self.process = subprocess.Popen([stability.PROGRAM, "--serve"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.rows = stability.read_rows()

    def run(self, precision, name, xs):
        """Rows of numbers, rounded to what the precision takes -> rows of results."""
        row = self.rows[name]
        xs = np.atleast_2d(np.asarray(xs, "f8"))
        assert xs.shape[1] == row.inputs, f"{name} takes {row.inputs} numbers, not {xs.shape[1]}"
        self.process.stdin.write(f"{name} {precision} {len(xs)}\n".encode() + np.ascontiguousarray(xs).tobytes())
        self.process.stdin.flush()
        data = self.process.stdout.read(8 * len(xs) * row.outputs)
        return np.frombuffer(data, "f8").reshape(len(xs), row.outputs)


@pytest.fixture(scope="module")
def server():
    made = Server()
    with made.process:   # its end closes the pipes, upon which the process ends
        yield made
    assert made.process.returncode == 0


@pytest.fixture(params=["f32", "f64"])
def precision(request):
    return request.param


@pytest.fixture
def call(server, precision):
    """call(function, numbers...) -> one row of results."""
    return lambda name, *parts: server.run(precision, name, np.concatenate([np.ravel(part).astype("f8") for part in parts]))[0]


# ---- what hypothesis draws ---------------------------------------------------------------------------------------------------------

def between(low, high):
    """Floats of 32 bits, so that both precisions see the same number."""
    return st.floats(float(np.float32(low)), float(np.float32(high)), width=32)


@st.composite
def directions(draw, low_z=-1.0):
    """Unit vectors; the simplest is straight up."""
    x, y = draw(between(-1, 1)), draw(between(-1, 1))
    z = draw(between(-1, 1)) if low_z < 0 else draw(between(0, 1))
    v = np.array([x, y, z])
    length = np.linalg.norm(v)
    v = v / length if length > 1e-3 else UP
    if low_z >= 0:
        v[2] = max(v[2], low_z)
        v = v / np.linalg.norm(v)
    return v.astype("f4").astype("f8")


units = between(0, 1 - 2**-24)
shares = between(0, 1)
alphas = between(0.01, 1)
colours = st.tuples(shares, shares, shares)
words = st.tuples(st.integers(0, 65535), st.integers(0, 65535))


def point_of(slopes_f, slopes_b, phi, omega):
    """11 numbers, as the maps give them."""
    f, b = np.array([-slopes_f[0], -slopes_f[1], 1.0]), np.array([-slopes_b[0], -slopes_b[1], 1.0])
    len_f, len_b = np.linalg.norm(f), np.linalg.norm(b)
    t = np.array([np.cos(phi), np.sin(phi), slopes_f[0] * np.cos(phi) + slopes_f[1] * np.sin(phi)])
    t /= np.linalg.norm(t)
    t = np.cos(omega) * t + np.sin(omega) * np.cross(f / len_f, t)
    return np.r_[f / len_f, b / len_b, t, len_f, len_b].astype("f4").astype("f8")


slopes = st.tuples(between(-4, 4), between(-4, 4))
points = st.builds(point_of, slopes, slopes, between(0, 3.14159), between(-3.14159, 3.14159))


def yarn_of(colours_of, alpha_r, alpha_t, thickness, mix):
    return np.r_[np.ravel(colours_of), alpha_r, alpha_t, thickness, 0, mix]


yarns = st.builds(yarn_of, st.tuples(colours, colours, colours, colours), alphas, alphas, between(1e-4, 100), shares)


def rtol(precision, double, single):
    return double if precision == "f64" else single


# ---- the BSDF -------------------------------------------------------------------------------------------------------------------------

@SETTINGS
@hypothesis.given(p=points, y=yarns, i=directions(), o=directions(1e-6), slab=st.integers(0, 1))
def test_value_and_pdf_are_finite_and_not_negative(call, p, y, i, o, slab):
    value, pdf = call("point_value", p, y, i, o, slab), call("point_pdf", p, y, i, o)
    assert np.isfinite(value).all() and (value >= 0).all()
    assert np.isfinite(pdf).all() and (pdf >= 0).all()
    assert 0 <= call("unscattered", p, y, o, 0)[0] <= 1


@SETTINGS
@hypothesis.given(p=points, alpha=alphas, thickness=between(0.1, 10), i=directions(), o=directions(1e-3))
def test_value_is_zero_where_the_point_faces_away_and_nowhere_else(call, p, alpha, thickness, i, o):
    white = yarn_of(np.ones(12), alpha, alpha, thickness, 0.5)
    facing = p[:3] @ o
    hypothesis.assume(abs(facing) > 1e-5 and (abs(i[2]) > 1e-5 or i[2] == 0))
    assert (call("point_value", p, white, i, o, 0) > 0).all() == (facing > 0 and i[2] != 0)
    assert (call("point_value", p, white, i, o, 0) == 0).all() == (facing < 0 or i[2] == 0)


@SETTINGS
@hypothesis.given(p=points, y=yarns, o=directions(1e-3), u=st.tuples(units, units, units, units))
def test_sample_has_the_pdf_of_its_direction(call, precision, p, y, o, u):
    sample = call("point_sample", p, y, o, u)
    wi, pdf = sample[:3], sample[3]
    assert np.isfinite(sample).all() and pdf >= 0 and abs(np.linalg.norm(wi) - 1) < 1e-5
    if pdf == 0:
        assert np.array_equal(wi, UP)
    else:
        again = call("point_pdf", p, y, wi, o)[0]
        assert np.isclose(again, pdf, rtol=rtol(precision, 1e-10, 2e-3), atol=0)


@SETTINGS
@hypothesis.given(d=between(1e-4, 30), sigma=st.tuples(between(0.01, 1), between(0.01, 1)), c=st.tuples(between(1e-6, 1), between(1e-6, 1)),
                  thickness=between(1e-4, 100))
def test_slab_kernels_are_reciprocal_and_bounded(call, precision, d, sigma, c, thickness):
    for row in ("slab_reflect", "slab_transmit"):
        k = call(row, d, sigma, c, thickness)[0]
        assert np.isclose(k, call(row, d, sigma[::-1], c[::-1], thickness)[0], rtol=rtol(precision, 1e-12, 1e-5), atol=1e-35)
        # A flake slab sends no more along a direction than a mirror of all its flakes: a D / (4 sigma_o) c_o.
        assert 0 <= k <= d / 4 * min(c[0] / sigma[0], c[1] / sigma[1]) * (1 + 1e-5)


@SETTINGS
@hypothesis.given(p=points, alpha=alphas, thickness=between(0.01, 20), i=directions(1e-2), o=directions(1e-2))
def test_point_is_reciprocal_in_reflection(call, precision, p, alpha, thickness, i, o):
    """K = f c_i c_o is symmetric; a sample's value is K / c_o."""
    mirror_yarn = yarn_of(np.r_[np.ones(6), np.zeros(6)], alpha, alpha, thickness, 1)
    c_i, c_o = p[:3] @ i, p[:3] @ o
    hypothesis.assume(min(c_i, c_o) > 1e-3)
    there, back = call("point_value", p, mirror_yarn, i, o, 0) * c_o, call("point_value", p, mirror_yarn, o, i, 0) * c_i
    assert np.allclose(there, back, rtol=rtol(precision, 1e-5, 1e-3), atol=1e-30)   # the cosines here are of rounded vectors


@SETTINGS
@hypothesis.given(p=points, alpha=alphas, thickness=between(0.01, 20), i=directions(1e-2), o=directions(1e-2))
def test_cloth_turned_over_transmits_the_same(call, precision, p, alpha, thickness, i, o):
    """Seen from the back, in its mirrored frame, front and back swap, and so do light and view. A value is |N_b|/|N_f| K / c_o."""
    clear = yarn_of(np.r_[np.ones(6), np.zeros(6)], alpha, alpha, thickness, 1)
    below = i * [1, 1, -1]
    n_f, n_b, t, len_f, len_b = p[:3], p[3:6], p[6:9], p[9], p[10]
    hypothesis.assume(min(n_f @ o, n_b @ i) > 1e-3 and np.linalg.norm(below + o) > 1e-2)
    turned = np.r_[n_b, n_f, t * [1, 1, -1], len_b, len_f]
    front = call("point_value", p, clear, below, o, 0) * (n_f @ o) * len_f / len_b
    back = call("point_value", turned, clear, o * [1, 1, -1], i, 0) * (n_b @ i) * len_b / len_f
    assert np.allclose(front, back, rtol=rtol(precision, 1e-5, 2e-3), atol=1e-30)


@SETTINGS
@hypothesis.given(p=points, y=yarns, i=directions(), o=directions(1e-3), axis=st.integers(0, 1))
def test_mirrored_cloth_gives_the_same(call, precision, p, y, i, o, axis):
    flip = np.where(np.arange(3) == axis, -1.0, 1.0)
    mirrored = np.r_[p[:3] * flip, p[3:6] * flip, p[6:9] * flip, p[9:]]
    for slab in (0, 1):
        assert np.allclose(call("point_value", p, y, i, o, slab), call("point_value", mirrored, y, i * flip, o * flip, slab),
                           rtol=rtol(precision, 1e-9, 1e-3), atol=1e-12)


@hypothesis.settings(SETTINGS, max_examples=40)
@hypothesis.given(alpha=between(0.03, 1), thickness=between(0.01, 20), o=directions(0.02), phi=between(0, 3.14159), tilt=between(-1.5, 1.5))
def test_slab_gives_back_no_more_than_it_receives(server, precision, alpha, thickness, o, phi, tilt):
    """R1 + T1 + U <= 1 with albedo 1: value / pdf averaged over stratified samples."""
    t = np.array([np.cos(phi) * np.cos(tilt), np.sin(phi) * np.cos(tilt), np.sin(tilt)])
    p, y = np.r_[UP, UP, t, 1, 1], yarn_of(np.r_[np.ones(6), np.zeros(6)], alpha, alpha, thickness, 1)
    grid = (np.arange(32) + 0.5) / 32
    u = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)
    same = np.broadcast_to(np.r_[p, y, o, 0.5], (len(u), 32))
    samples = server.run(precision, "point_sample", np.c_[same, np.full(len(u), 0.5), u])
    keep = samples[:, 3] > 0
    one = np.broadcast_to(np.r_[p, y], (keep.sum(), 28))
    values = server.run(precision, "point_value", np.c_[one, samples[keep, :3], np.broadcast_to(o, (keep.sum(), 3)), np.zeros(keep.sum())])
    scattered = (values[:, 0] / samples[keep, 3]).sum() / len(u)
    through = server.run(precision, "unscattered", np.r_[p, y, o, 0])[0, 0]
    assert 0 <= scattered and scattered + through <= 1.003, (scattered, through)


@SETTINGS
@hypothesis.given(albedo=colours, front=shares, back=shares)
def test_interreflection_adds_no_light(call, albedo, front, back):
    """The series over all bounces: direct light and the rest together are at most what an open place receives."""
    extra = call("interreflection", albedo, front, back)
    assert (extra >= 0).all() and (extra + np.repeat([front, back], 3) <= 1 + 1e-5).all()


@SETTINGS
@hypothesis.given(y=yarns)
def test_lobes_are_chosen_with_probability_one_or_never(call, y):
    weights = call("lobe_weights", y)
    assert (weights >= 0).all() and (abs(weights.sum() - 1) < 1e-6 or not weights.any())
    assert weights.any() == bool(y[:12].any())


@SETTINGS
@hypothesis.given(w=directions(), t=directions(), alpha=alphas, u=st.tuples(units, units))
def test_flakes_seen_face_the_viewer(call, w, t, alpha, u):
    assert alpha * (1 - 1e-5) <= call("sggx_sigma", w, t, alpha)[0] <= 1 + 1e-5
    m = call("sggx_sample_vndf", w, t, alpha, u)
    assert abs(np.linalg.norm(m) - 1) < 1e-5 and m @ w > -1e-5 / alpha


@SETTINGS
@hypothesis.given(a=between(0, 1e6), b=between(0, 1e6))
def test_phi1_falls_from_one(call, a, b):
    low, high = sorted((a, b))
    assert 1 >= call("phi1", low)[0] >= call("phi1", high)[0] * (1 - 1e-6) >= 0


# ---- frames, maps, lights -----------------------------------------------------------------------------------------------------------------

@SETTINGS
@hypothesis.given(n=st.one_of(directions(), st.sampled_from([-UP, UP, np.array([0, 0, -1.0]), np.array([-0.0, -0.0, -1.0]), np.array([1, 0, -0.0])])))
def test_frame_is_orthonormal_and_right_handed(call, precision, n):
    frame = call("frame", n).reshape(3, 3)
    tolerance = 5e-7   # n itself is a rounded unit vector
    assert np.allclose(frame @ frame.T, np.eye(3), atol=tolerance) and np.allclose(np.cross(frame[0], frame[1]), frame[2], atol=tolerance)
    assert np.allclose(frame[2], n, atol=0)


@SETTINGS
@hypothesis.given(knots=st.lists(st.integers(0, 65535), min_size=4, max_size=4), d=directions())
def test_horizon_visibility_is_a_share(call, knots, d):
    v = call("horizon_visibility", knots, d)[0]
    assert 0 <= v <= 1 and (v == 0 or d[2] > 0)
    assert d[2] <= 1e-5 or call("horizon_visibility", np.zeros(4), d)[0] == 1   # no horizon, no shade


@SETTINGS
@hypothesis.given(mu=directions(1e-3), gamma=between(-4, 4), sigma=st.tuples(between(0, 1e4), between(0, 1e4)), amplitude=between(0, 100), d=directions())
def test_asg_visibility_is_a_share(call, mu, gamma, sigma, amplitude, d):
    assert 0 <= call("asg_visibility", mu, gamma, sigma, amplitude, 0, d)[0] <= 1


settings_of_model = st.tuples(st.integers(0, 1), st.integers(0, 3), st.integers(0, 2), *[st.integers(0, 1)] * 4)
fabrics = st.builds(lambda tile, low, high, cells, amplitude: np.r_[tile, -np.array(low) * min(tile), np.array(high) * min(tile), cells, amplitude],
                    st.tuples(between(1e-4, 1), between(1e-4, 1)), st.tuples(shares, shares), st.tuples(shares, shares),
                    st.tuples(st.integers(1, 64), st.integers(1, 64)), shares)
extents = st.tuples(*[between(-64, 64)] * 4)


@SETTINGS
@hypothesis.given(fabric=fabrics, side=st.integers(0, 1), model=settings_of_model, tile=st.tuples(between(-100, 100), between(-100, 100)), extent=extents,
                  o=directions(1e-6), seed=words, index=st.integers(0, 63))
def test_selection_passes_or_has_a_weight(call, fabric, side, model, tile, extent, o, seed, index):
    s = call("select_model", fabric, side, model, tile, extent, 0, 0, o, seed, index, 0, 0)
    assert np.isfinite(s).all() and s[0] in (0, 1) and s[1] >= 0
    if s[0] == 0:
        assert np.allclose(np.linalg.norm(s[2:11].reshape(3, 3), axis=1), 1, atol=1e-5)
    assert 0 <= s[18] <= 1 and 0 <= s[19] <= 1
    assert (s[[18, 19]] == 1).all() or (model[0] == 1 and model[2] != 0)


@SETTINGS
@hypothesis.given(fabric=fabrics, model=settings_of_model, tile=st.tuples(between(-100, 100), between(-100, 100)), d=directions())
def test_transmittance_is_the_same_both_ways(call, fabric, model, tile, d):
    there, back = call("transmittance_model", fabric, model, tile, d)[0], call("transmittance_model", fabric, model, tile, -d)[0]
    assert np.isfinite(there) and there >= 0 and there == back


@SETTINGS
@hypothesis.given(d=directions(), rotation=between(-7, 7))
def test_environment_directions_come_back(call, precision, d, rotation):
    uv = call("environment_uv", d, rotation)
    assert (uv >= 0).all() and (uv <= 1).all()
    assert np.allclose(call("environment_direction", uv, rotation), d / np.linalg.norm(d), atol=rtol(precision, 1e-12, 5e-6))


@SETTINGS
@hypothesis.given(u=st.tuples(between(0.01, 0.99), between(0.01, 0.99)), bits=st.tuples(words, words), rotation=between(-7, 7))
def test_a_sampled_texel_is_the_one_that_is_found(call, precision, u, bits, rotation):
    """The texel that bits choose, the direction in it and what a ray that way finds have one pdf and one radiance."""
    light = np.r_[0, 1, np.zeros(6), 1, 1, 1, np.zeros(6), rotation, 0]
    sampled = call("light_sample", light, 0, 0, 0, u, bits)
    # At a texel's edge float's directions do not tell its neighbour from it, and neighbours differ by 1e16.
    place = call("environment_uv", sampled[:3], rotation) * ENVIRONMENT % 1
    hypothesis.assume(((place > 1e-3) & (place < 1 - 1e-3)).all())
    found = call("light_hit", light, 0, 0, 0, sampled[:3])
    assert np.allclose(found[7], sampled[7], rtol=rtol(precision, 1e-9, 1e-4), atol=1e-30)
    if precision == "f64":   # neighbouring texels differ by 1e16, which float's directions do not tell
        assert np.allclose(found[4:7], sampled[4:7], rtol=1e-5, atol=0)


@SETTINGS
@hypothesis.given(colour=st.tuples(between(0, 1e8), between(0, 1e8), between(0, 1e8)), exposure=between(-20, 20))
def test_display_stays_on_the_display(call, colour, exposure):
    shown = call("display", colour, exposure)
    assert (shown >= 0).all() and (shown <= 1 + 1e-5).all()


@SETTINGS
@hypothesis.given(seed=words, index=words, dimension=st.integers(0, 63))
def test_random_numbers_stay_below_one(server, seed, index, dimension):
    drawn = [server.run(precision, "random", np.r_[seed, index, dimension, 0]) for precision in ("f32", "f64")]
    assert np.array_equal(*drawn) and (drawn[0] >= 0).all() and (drawn[0] < 1).all()
