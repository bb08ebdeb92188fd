"""The shared functions on inputs that hunt trouble, in short: every result is a number and lies in its range. The long run is
./dev bench stability.

Seen red with a macroscopic slab cosine that may become 0 (C++), with phi1 without its series (a copy in $SELVEDGE_GLSL), and with a
row that has no signature."""
import json
import subprocess

import numpy as np
import pytest

import bench_report
import evaluate
from bench import stability

C_INPUTS, GLSL_INPUTS = 300_000, 30_000


@pytest.fixture(scope="module")
def cpp():
    return stability.cpp_statistics(C_INPUTS)


def complaint(statistics):
    return {name: entry for name, entry in statistics.items() if entry["not_finite"] or entry["out_of_range"]}


def test_every_row_is_drawn_for(cpp):
    """A function is covered by having a row; one without a distribution of inputs would have ended the program."""
    rows = stability.read_rows()
    assert set(cpp) == set(rows) and set(evaluate.ROWS) < set(rows)
    assert all(entry["inputs"] >= C_INPUTS // len(rows) for entry in cpp.values())
    listed = json.loads(stability.run_program("--list"))
    assert {name: [row.inputs, row.outputs] for name, row in rows.items()} == listed


def test_results_are_numbers_in_their_range(cpp):
    assert not complaint(cpp)


def test_bits_are_the_same_and_simple_functions_exact(cpp):
    """The quantiles can be trusted only if they tell: equal bits, errors of a few units, more where rounding is magnified."""
    assert all(cpp[name]["max"] == 0 for name in ("hash", "hash_combine", "random", "random_bits", "block_length", "horizon_at"))
    for name in ("frame", "unit_vector", "sggx_sigma", "slab_transmit", "phi1", "lobe_weights", "cosine_sample", "srgb", "noise"):
        entry = cpp[name]
        assert 0 < entry["q99_9"] <= entry["q99_9999"] and entry["max"] < 2e-5, (name, entry)
        assert entry["max"] <= entry["q99_9999"] <= entry["max"] * 2 ** (1 / 16), (name, entry)   # few inputs: the last bin


def test_an_input_can_be_replayed(cpp):
    """(function, index) is all that it takes: the run's worst error comes again, and the raw inputs are those of the replay."""
    entry = cpp["sggx_d_half"]
    again = stability.replay("sggx_d_half", entry["worst_index"])
    assert again["error"] == entry["max"] and again["same_decisions"]
    assert again == stability.replay("sggx_d_half", entry["worst_index"])
    for name in ("point_value", "camera_sample"):
        replayed = stability.replay(name, 777)
        raw = np.frombuffer(stability.run_program("--inputs", name, 770, 20), "f4").reshape(20, -1)
        assert np.array_equal(raw[7].astype(float), replayed["input"])
    # The shipped evaluator makes the same of it.
    value = stability.replay("point_value", 777)
    evaluator = evaluate.CppEvaluator("f64")
    assert np.array_equal(evaluator.run(evaluate.ROWS["point_value"], np.array([value["input"]]))[0], value["double"])


def test_inputs_reach_the_edges():
    """The distribution hunts: grazing views, light along and against the view, fibres along normals, the floor of alpha, ..."""
    def rows(name, count=20000):
        width = stability.read_rows()[name].inputs
        return np.frombuffer(stability.run_program("--inputs", name, 0, count), "f4").reshape(count, width).astype(float)

    x = rows("point_value")
    n_f, t, alpha, i, o = x[:, :3], x[:, 6:9], x[:, 23], x[:, 28:31], x[:, 31:34]
    assert (o[:, 2] > 0).all() and (o[:, 2] < 2e-7).any()
    assert (np.linalg.norm(i - o, axis=1) == 0).any() and (np.linalg.norm(i + o, axis=1) == 0).any()
    near = np.linalg.norm(i + o, axis=1)
    assert ((near > 0) & (near < 1e-6)).any()
    assert (alpha == np.float32(0.01)).any() and alpha.min() >= np.float32(0.01) and alpha.max() == 1
    along = np.einsum("nk,nk->n", n_f, t)
    assert (along > 1 - 1e-6).any() and (along < -1 + 1e-6).any()
    assert (i[:, 2] == 0).any()
    x = rows("select_model")
    extent = np.linalg.norm(x[:, 19:21], axis=1) * 48
    assert (extent == 0).any() and extent.max() > 9e5
    assert {tuple(row) for row in x[:, 10:13].astype(int)} == {(b, w, v) for b in range(2) for w in range(4) for v in range(6)}
    x = rows("light_sample")
    assert set(x[:, 0]) == set(range(7)) and (np.linalg.norm(x[:, 2:5] - x[:, 19:22], axis=1) == 0).any()
    intensity = x[:, 8:11][x[:, 8:11] > 0]
    assert intensity.min() < 1e-7 and intensity.max() > 1e7
    x = rows("surface")
    assert np.abs(x[:, 18:24]).max() > 5e5 and (np.ptp(x[:, [18, 20, 22]], axis=1) == 0).any()


@pytest.mark.parametrize("backend", evaluate.BUILDS[2:])
def test_shaders_give_numbers_in_their_range(backend):
    statistics, _ = stability.glsl_statistics(backend, GLSL_INPUTS)
    assert set(statistics) == set(stability.read_rows())
    assert not complaint(statistics)
    assert statistics["random"]["max"] == 0 and statistics["sggx_sigma"]["max"] < 2e-5


@pytest.mark.parametrize("words, message", [(["--replay", "nothing", "0"], "no function nothing"), (["--count", "many"], "'many' is no number"),
                                            (["--nonsense", "1"], "unknown --nonsense"), (["--functions", "hash,nothing"], "no function nothing")])
def test_wrong_words_are_refused(words, message):
    done = subprocess.run([stability.PROGRAM, *words], capture_output=True, text=True)
    assert done.returncode == 2 and message in done.stderr and done.stdout == ""


def test_report_is_written_and_shown(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["stability", "--cpp", "20000", "--egl", "0", "--osmesa", "0", "--out", str(tmp_path)])
    assert stability.main() == 0
    report = json.loads((tmp_path / "stability.json").read_text())
    assert report["figures"]["cpp.not_finite"] | {"value": 0, "target": 0} == report["figures"]["cpp.not_finite"]
    assert set(report["functions"]["cpp"]) == set(stability.read_rows())
    assert "| `cpp.not_finite` | 0 | ≤ 0 | met |" in bench_report.document([report])
    text = bench_report.stability_document(report)
    assert all(f"| `{name}` |" in text for name in report["functions"]["cpp"]) and "NaN or infinite: 0;" in text
    assert bench_report.met(report["figures"]["cpp.out_of_range"])


def test_a_bad_result_fails_the_suite(tmp_path, monkeypatch):
    entry = {"inputs": 5, "flipped": 0, "not_finite": 1, "out_of_range": 0, "q50": 0, "q99_9": 0, "q99_9999": 0, "max": 0, "worst_index": 0,
             "unexplained": 0, "surplus": 0, "surplus_index": 0, "bad": [3]}
    monkeypatch.setattr(stability, "cpp_statistics", lambda count: {"hash": entry})
    monkeypatch.setattr("sys.argv", ["stability", "--egl", "0", "--osmesa", "0", "--out", str(tmp_path)])
    assert stability.main() == 1
