"""Every shared function, in four builds, against an implementation that shares no code with it (cloth_oracle.py)."""
import numpy as np
import pytest

import cloth_oracle as oracle
import evaluate
import shared_functions
from shared_functions import FUNCTIONS

# math.md 11: double to 1e-10 (issue 3), float and GLSL to 2e-5 on inputs that are floats.
RTOL = {"f64": 1e-10, "f32": 2e-5, "egl": 2e-5, "osmesa": 2e-5}
ULP = {"f64": 2.0**-52, "f32": 2.0**-23, "egl": 2.0**-23, "osmesa": 2.0**-23}
# An input may be ill-conditioned: moving every number of it by this many units in the last place moves the exact answer by
# more than RTOL. What such a move does to the exact answer is then allowed, and how many inputs need that is limited.
ULPS = 6


def measured_against(function, want):
    """Length of the vector that a number belongs to, |value| for numbers alone; at least the floor."""
    if not function.groups:
        return np.maximum(np.abs(want), function.floor)
    assert sum(function.groups) == want.shape[1]
    scale, first = np.empty_like(want), 0
    for width in function.groups:
        scale[:, first:first + width] = np.maximum(np.linalg.norm(want[:, first:first + width], axis=1), function.floor)[:, None]
        first += width
    return scale


def expected(function, xs):
    want = np.asarray(function.expect(xs), float)
    return want[:, None] if want.ndim == 1 else want


def allowance(function, xs, want, ulp, rng):
    """How far the exact answer moves when the input moves by ULPS units in the last place: the largest of a few moves."""
    moved = np.zeros_like(want)
    for _ in range(8):
        shift = rng.uniform(-1, 1, xs.shape)
        # Whole numbers are kinds, indices and bits, not measurements: they stay.
        whole = xs == np.round(xs)
        near = np.where(whole, xs, xs * (1 + shift * ULPS * ulp))
        moved = np.maximum(moved, np.abs(expected(function, near) - want))
    return moved


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_agrees_with_the_oracle(name, build, evaluator, record_property):
    function = FUNCTIONS[name]
    rng = np.random.default_rng(abs(hash_of(name)))
    xs = np.asarray(function.inputs(rng), float)
    if build != "f64":
        xs = xs.astype("f4").astype("f8")
    tables = shared_functions.TABLES if function.tables else None
    with np.errstate(all="ignore"):
        got, want = evaluator.run(build, name, xs, tables), expected(function, xs)
        assert want.shape == got.shape
        assert np.isfinite(want).all(), "the oracle itself is not finite"
        if function.exact:
            wrong = (got != want).any(1)
            assert not wrong.any(), f"{wrong.sum()} of {len(xs)} differ, first {xs[wrong][0]}: {got[wrong][0]}, expected {want[wrong][0]}"
            return
        scale = measured_against(function, want)
        error = np.abs(got - want) / scale
        error[~np.isfinite(got)] = np.inf
        beyond = error > RTOL[build]
        if not function.strict and beyond.any():
            rows = beyond.any(1)
            extra = np.zeros_like(error)
            extra[rows] = allowance(function, xs[rows], want[rows], ULP[build], rng) / scale[rows]
            if function.slack:
                extra[rows] += ULP[build] * np.asarray(function.slack(xs[rows])).reshape(rows.sum(), -1) / scale[rows]
            bad = error > RTOL[build] + extra
        else:
            bad = beyond
    within = error[~beyond.any(1)]
    figures = {"strict_max": float(within.max()) if within.size else 0.0, "ill_conditioned": float(beyond.any(1).mean()), "max": float(error.max())}
    for key, value in figures.items():
        record_property(key, value)
    worst = np.unravel_index(np.argmax(np.where(bad, error, -1)), error.shape)
    assert not bad.any(), (
        f"{name} in {build}: {bad.any(1).sum()} of {len(xs)} inputs beyond {RTOL[build]:g}; the worst, {error[worst]:.3g}, at output {worst[1]} of\n"
        f"  {xs[worst[0]].tolist()}\n  got      {got[worst[0]].tolist()}\n  expected {want[worst[0]].tolist()}")
    assert beyond.any(1).mean() <= function.loose, f"{beyond.any(1).mean():.2%} of the inputs need the allowance ({function.why})"


def hash_of(name):
    """A seed that is the same in every run, unlike hash()."""
    return oracle.hash32(int.from_bytes(name.encode()[:4], "little"))


def test_every_row_has_a_function():
    assert set(evaluate.ROWS) == set(FUNCTIONS)
    assert all(function.strict or function.exact or function.why for function in FUNCTIONS.values()), "a bound needs its reason"


# ---- math.md section 11 --------------------------------------------------------------------------------------------------------

def unit(*v):
    return np.array(v, float) / np.linalg.norm(v)


T_A, T_B, I_1, O_1, I_B = unit(1, 0.2, 0.1), unit(0.3, 1, -0.4), unit(0.4, -0.3, 0.8), unit(-0.2, 0.5, 0.7), unit(0.3, -0.2, -0.9)
H_1 = unit(*(I_1 + O_1))
ACROSS = unit(*np.cross(T_A, [0, 0, 1]))
EQUAL_I, EQUAL_T = np.array([O_1[0], O_1[1], -O_1[2]]), unit(1, 0.2, 0)
N_SLOPED = unit(-0.4, 0.7, 1)


def slab_value(evaluator, build, row, i, o, t, alpha, thickness, per_cosines=True):
    """f = K / (c_i c_o) about n = z, from the shipped functions."""
    d = evaluator.run(build, "sggx_d_half", np.r_[i, o, t, alpha])[0, 0]
    s_i, s_o = (evaluator.run(build, "sggx_sigma", np.r_[w, t, alpha])[0, 0] for w in (i, o))
    k = evaluator.run(build, row, [d, s_i, s_o, abs(i[2]), abs(o[2]), thickness])[0, 0]
    return k / (abs(i[2]) * abs(o[2])) if per_cosines else k


REFERENCE = [
    ("sggx_sigma", np.r_[O_1, T_A, 0.2], 0.999472388285467),
    ("sggx_sigma", np.r_[T_A, T_A, 0.01], 0.01),
    ("sggx_sigma", np.r_[unit(*(T_A + [0, 0, 1e-4])), T_A, 0.01], 0.0100004951666421),
    ("sggx_d", np.r_[H_1, T_A, 0.2], 0.279942136357204),
    ("sggx_d", np.r_[H_1, T_A, 0.01], 9.53548100216153e-05),
    ("sggx_d", np.r_[ACROSS, T_A, 0.01], 31.8309886183791),
    ("sggx_d", np.r_[T_A, T_A, 0.05], 3.97887357729739e-05),
    ("sggx_d_antiparallel", np.r_[O_1, T_A, 0.2], 0.165615244439932),
    ("sggx_d_antiparallel", np.r_[O_1, T_A, 0.01], 0.159258396004109),
    ("sggx_sample_vndf", np.r_[O_1, T_A, 0.2, 0.37, 0.81], [-0.207562632512996, 0.939985271825822, 0.270823636957357]),
    ("sggx_sample_vndf", np.r_[O_1, T_A, 0.01, 0.37, 0.81], [-0.214314515703626, 0.938702716900901, 0.270012032401496]),
    ("phi1", [0.01], 0.995016625083195),
    ("phi1", [0.5], 0.786938680574733),
    ("diffuse", np.r_[N_SLOPED, I_1, 0.7], 0.0960252183510032 / 0.6),
]
SLABS = [
    ("slab_reflect", I_1, O_1, T_A, 0.2, 1.5, True, 0.0433651965334444),
    ("slab_reflect", I_1, O_1, T_A, 0.04, 3, True, 0.000930049791843837),
    ("slab_reflect", O_1, O_1, T_A, 0.2, 1.5, True, 0.232970983114117),
    ("slab_transmit", I_B, O_1, T_A, 0.2, 1.5, True, 0.00913256465874552),
    ("slab_transmit", EQUAL_I, O_1, EQUAL_T, 0.2, 1.5, True, 0.0448974902863239),
    ("slab_transmit", -O_1, O_1, T_A, 0.2, 1.5, True, 0.014912576230396),
]


@pytest.mark.parametrize("row, inputs, value", REFERENCE, ids=lambda v: v if isinstance(v, str) else "")
def test_reference_values_hold(row, inputs, value, build, evaluator):
    got = evaluator.run(build, row, inputs)[0]
    assert np.allclose(got, value, rtol={"f64": 1e-13}.get(build, 2e-5), atol=1e-13 if build == "f64" else 1e-6 * np.ndim(value)), got


@pytest.mark.parametrize("row, i, o, t, alpha, thickness, per_cosines, value", SLABS, ids=lambda v: v if isinstance(v, str) else "")
def test_reference_slabs_hold(row, i, o, t, alpha, thickness, per_cosines, value, build, evaluator):
    got = slab_value(evaluator, build, row, i, o, t, alpha, thickness, per_cosines)
    assert np.isclose(got, value, rtol={"f64": 1e-13}.get(build, 3e-5)), got


@pytest.mark.parametrize("row, i, value", [("slab_reflect", I_1, 4.30751581451265e-09), ("slab_transmit", I_B, 1.62072142037634e-09)])
def test_reference_grazing_slabs_hold(row, i, value, build, evaluator):
    got = slab_value(evaluator, build, row, i, unit(1, 0, 1e-6), T_A, 0.2, 1.5, False)
    assert np.isclose(got, value, rtol={"f64": 1e-10}.get(build, 3e-5)), got


def test_oracle_gives_the_reference_values():
    """The oracle is typed from the same file; this holds it to digits that a third implementation made."""
    for row, inputs, value in REFERENCE:
        got = np.squeeze(expected(FUNCTIONS[row], np.atleast_2d(inputs)))
        assert np.allclose(got, value, rtol=1e-12, atol=1e-13), (row, got)
    assert np.isclose(oracle.sggx_d_w(O_1, H_1, T_A, 0.2), 0.23401086771504, rtol=1e-12)


def test_reference_pdf_holds(build, evaluator):
    for i, value in ((I_1, 0.0700224787693805), (I_B, 0.0254980845792983)):
        yarn = [1, 1, 1] + [0] * 9 + [0.2, 0.2, 1.5, 0, 1]
        point = np.r_[[0, 0, 1, 0, 0, 1], T_A, [1, 1]]
        got = evaluator.run(build, "point_pdf", np.r_[point, yarn, i, O_1])[0, 0]
        assert np.isclose(got, value, rtol={"f64": 1e-13}.get(build, 2e-5))


# ---- what all builds must do at once ----------------------------------------------------------------------------------------------

def test_shaders_and_cpp_draw_the_same_bits(evaluator):
    """The two renderers share sequences only if not one bit differs."""
    rng = np.random.default_rng(3)
    xs = shared_functions.draws(rng)
    results = {build: evaluator.run(build, "random", xs) for build in evaluate.BUILDS}
    assert all((result == results["f64"]).all() for result in results.values())
    assert all((0 <= result).all() and (result < 1).all() for result in results.values())


def test_environment_directions_and_coordinates_are_inverse(build, evaluator):
    rng = np.random.default_rng(4)
    uv = rng.uniform(0.001, 0.999, (4000, 2))
    rotation = rng.uniform(-3, 3, 4000)
    d = evaluator.run(build, "environment_direction", np.c_[uv, rotation])
    back = evaluator.run(build, "environment_uv", np.c_[d, rotation])
    around = np.abs((back - uv + 0.5) % 1 - 0.5)
    # Near the poles (v = .001) the azimuth is told by vectors 3e-3 long.
    assert around.max() < (1e-12 if build == "f64" else 3e-5)


def test_a_yarn_direction_near_the_normal_is_perpendicular_or_none(evaluator, build):
    """Rounding leaves 1e-7 along the normal of what is 1e-3 of a vector's length and more across it. Seen red with directions down to 1e-6:
    frames that were 0.08 off."""
    rng = np.random.default_rng(5)
    away, turn, tilt = 10 ** rng.uniform(-9, -1, 4000), rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, 2 * np.pi, 4000)
    u = np.stack([np.cos(tilt), np.sin(tilt), 0.3 + 0 * tilt], -1)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    across = np.cross(u, [0, 0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normal = u + away[:, None] * (across * np.cos(turn)[:, None] + np.cross(u, across) * np.sin(turn)[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    xs = np.zeros((4000, 27))
    xs[:, 3:6], xs[:, 6:9] = u, across    # corners at 0, dp/du and dp/dv
    xs[:, 20], xs[:, 23] = 1, 1           # texture coordinates 00, 10, 01
    xs[:, 24:27] = normal
    frame = evaluator.run(build, "uv_frame", xs).reshape(-1, 3, 3)
    assert np.abs(np.einsum("nik,njk->nij", frame, frame) - np.eye(3)).max() < (1e-12 if build == "f64" else 5e-4)
