"""Suite error-time and its report, on renderers whose error and speed are known: they add noise of variance 1/n to a picture.

Seen red without the correction for the long reference's noise, and with the ratio turned over."""
import json
import os
import pathlib
import stat
import subprocess
import sys
import xml.etree.ElementTree

import pytest

import bench_report
from bench import error_time

FAKE = """#!{python}
import json, sys
import numpy as np, OpenEXR
words = sys.argv[1:]
option = lambda name, otherwise=None: words[words.index(name) + 1] if name in words else otherwise
count = int(option("--spp", option("--frames")))
count = min(count, {limit})
width, height = map(int, option("--resolution").split(","))
assert option("--integrator") == "direct" and "--json" in words and "-q" in words
rng = np.random.default_rng([int(option("--seed")), count, {salt}])
y, x = np.mgrid[:height, :width] / width
truth = np.stack([1 + x, 1 + y, 2 + x * y], -1) * {bias}
weight = truth ** 2 + .01
clean = "--denoise" in words
weight = weight / 4 if clean else weight
image = truth + np.sqrt(weight / count) * rng.standard_normal(truth.shape)
channels = {{"RGB": image.astype("f4")}} | {{"variance." + c: (weight[..., k] / count).astype("f4") for k, c in enumerate("RGB")}}
OpenEXR.File({{"type": OpenEXR.scanlineimage}}, channels).write(option("-o"))
report = {{"seconds": {{"load": 0, "bake": 0, "build": 0, "render": {seconds} * count, "denoise": .001 * clean}}, "samples": count * width * height, "spp_mean": count}}
if "--headless" in words:
    report["gl"] = {{"renderer": "none", "version": "4.5", "backend": "osmesa"}}
print(json.dumps(report))
"""
SCENE = {"camera": {}, "lights": [{"type": "point"}], "objects": []}


@pytest.fixture
def fakes(tmp_path):
    """fakes(preview={...}, reference={...}): a folder of programs; the comparison is the real one."""
    def make(**programs):
        folder = tmp_path / "bin"
        folder.mkdir()
        for name, salt in (("preview", 1), ("reference", 2)):
            settings = {"limit": 1 << 20, "bias": 1.0, "seconds": .01} | programs.get(name, {})
            path = folder / {"preview": "selvedge-lookdev", "reference": "selvedge-render"}[name]
            path.write_text(FAKE.format(python=sys.executable, salt=salt, **settings))
            path.chmod(path.stat().st_mode | stat.S_IXUSR)
        (folder / "selvedge-compare").symlink_to((bench_report.BIN / "selvedge-compare").resolve())
        (tmp_path / "scene.json").write_text(json.dumps(SCENE))
        return folder
    return make


def run_suite(folder, out, *arguments):
    scene = folder.parent / "scene.json"
    script = pathlib.Path(error_time.__file__)
    done = subprocess.run([sys.executable, script, "--quick", "--scene", scene, "--out", out, "--resolution", "64", *map(str, arguments)],
                          capture_output=True, text=True, env=os.environ | {"SELVEDGE_BIN": str(folder)}, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads((out / "error-time.json").read_text()), done


def test_known_speed_and_noise_give_known_seconds(fakes, tmp_path):
    """relMSE is 1/n exactly, so 1e-2 takes 100 samples, and 25 with the filter, which takes 1 ms. The long reference has 300 only: its noise, 0.0033, has to come off."""
    folder = fakes(preview={"seconds": .01}, reference={"seconds": .06})
    out = tmp_path / "bench"
    report, done = run_suite(folder, out, "--truth-spp", 300, "--stop", 6e-3, "--passes", 2, "--series-seconds", 60)
    figures = report["figures"]
    assert figures["scene.preview.seconds_to_relmse_1e-2"]["value"] == pytest.approx(1.0, rel=.1)
    assert figures["scene.reference.seconds_to_relmse_1e-2"]["value"] == pytest.approx(6.0, rel=.1)
    speedup = figures["scene.speedup_at_relmse_1e-2"]
    assert speedup["value"] == pytest.approx(6.0, rel=.1)
    assert (speedup["target"], speedup["better"], speedup["runs"]) == (5, "higher", 2)   # delta lights only
    assert figures["scene.denoised.seconds_to_relmse_1e-2"]["value"] == pytest.approx(.251, rel=.1)
    cleaned = figures["scene.denoised_speedup_at_relmse_1e-2"]
    assert cleaned["value"] == pytest.approx(6 / .251, rel=.1) and cleaned["target"] == 5
    assert "noisy long reference" in figures["scene.preview.seconds_to_relmse_1e-3"]["note"]
    assert report["schema"] == 1 and report["suite"] == "error-time" and report["gl"] == "none, 4.5, osmesa" and report["cpu"] and report["git"]
    for entry in figures.values():
        assert set(entry) == {"value", "unit", "better", "target", "runs", "note"}
    for seconds, relmse, low, high in report["curves"]["scene.preview"]:
        assert low <= relmse <= high and relmse == pytest.approx(.01 / seconds, rel=.2)
    for name in ("scene", "scene.preview", "scene.reference"):
        assert xml.etree.ElementTree.parse(out / f"error-time-{name}.svg").getroot().tag.endswith("svg")
    assert "relMSE" in (out / "error-time-scene.svg").read_text()
    assert "scene.speedup_at_relmse_1e-2" in done.stdout

    page = tmp_path / "docs" / "benchmarks.md"
    page.parent.mkdir()
    subprocess.run([sys.executable, bench_report.__file__, "--out", out, "--document", page], check=True, capture_output=True)
    assert "| `scene.speedup_at_relmse_1e-2` |" in page.read_text()
    assert (page.parent / "bench" / "error-time-scene.svg").is_file()


def test_a_floor_is_not_extrapolated_through(fakes, tmp_path):
    """A preview that is 20 % off levels out at relMSE 0.04: it never reaches 0.01, and the report says so."""
    report, _ = run_suite(fakes(preview={"bias": 1.2}), tmp_path / "bench", "--truth-spp", 1000, "--stop", 5e-3, "--passes", 1,
                          "--series-seconds", 8)
    entry = report["figures"]["scene.preview.seconds_to_relmse_1e-2"]
    assert entry["value"] is None and "not reached" in entry["note"]
    assert report["figures"]["scene.speedup_at_relmse_1e-2"]["value"] is None


def test_a_failing_program_ends_the_suite_without_a_report(fakes, tmp_path):
    folder = fakes()
    (folder / "selvedge-lookdev").write_text("#!/bin/sh\nexit 1\n")
    done = subprocess.run([sys.executable, error_time.__file__, "--quick", "--scene", tmp_path / "scene.json", "--out", tmp_path / "bench",
                           "--resolution", "16", "--truth-spp", "4"], capture_output=True, text=True, env=os.environ | {"SELVEDGE_BIN": str(folder)})
    assert done.returncode == 1 and "selvedge-lookdev" in done.stderr and "exit status 1" in done.stderr
    assert not (tmp_path / "bench").exists()


@pytest.mark.parametrize("points, target, seconds", [
    ([[1, 1, 1e-1], [2, 2, 5e-2], [4, 4, 2.5e-2], [8, 8, 1.25e-2], [16, 16, 6.25e-3]], 1e-2, 10),   # between the last two
    ([[1, 1, 1e-3], [2, 2, 5e-4]], 1e-2, 1),                       # met from the start
    ([[1, 4, 8e-2], [2, 5, 4e-2], [4, 7, 2e-2]], 1e-2, 11),        # one doubling further: 4 samples more at 1 s each, after 3 s of set-up
    ([[1, 1, 8e-2], [2, 2, 7.9e-2], [4, 4, 7.8e-2]], 1e-2, None),  # a floor
    ([[1, 1, 8e-1], [2, 2, 4e-1]], 1e-3, None),                    # too far to guess
    ([[1, 0, 1e-1], [2, 0, 1e-2]], 1e-2, None),                    # a clock that stands still
    ([], 1e-2, None)])
def test_seconds_are_interpolated_in_logarithms(points, target, seconds):
    got, note = error_time.seconds_to([[*point, 0, 0] for point in points], target)
    assert got == (None if seconds is None else pytest.approx(seconds))
    assert (note == "") == (seconds == 10)


def test_a_busy_machine_is_named():
    assert bench_report.busy({"other_load": 0.1}) == ""
    assert "2.0 other threads" in bench_report.busy({"other_load": 2.0})
    assert bench_report.other_load() >= 0


def test_a_section_without_a_report_stays():
    """Of a card that this machine lacks, for one."""
    entry = bench_report.figure(3, "s", "lower")
    report = {"date": "2026-11-23", "git": "0", "cpu": "one", "gl": "", "other_load": 0, "figures": {"f": entry}, "curves": {"c": []}}
    before = bench_report.document([report | {"suite": "gpu"}, report | {"suite": "bake", "git": "1"}])
    after = bench_report.document([report | {"suite": "bake", "git": "2"}], before)
    assert after == before.replace("revision 1", "revision 2") != before
    assert "## gpu" in after and bench_report.document([], bench_report.DOCUMENT.read_text()) == bench_report.DOCUMENT.read_text()


def test_targets_know_better_from_worse():
    assert bench_report.met(bench_report.figure(3, "s", "lower", target=4)) is True
    assert bench_report.met(bench_report.figure(3, "x", "higher", target=4)) is False
    assert bench_report.met(bench_report.figure(3, "s", "lower")) is None
    assert bench_report.met(bench_report.figure(None, "s", "lower", target=4, note="why")) is None
