"""selvedge-compare: metrics against numpy and against the published FLIP, exit statuses, bad files, the variance test.

Seen red with relmse's floor at 0.001, with A and B exchanged in the bias, with A's variance left out of z, and with one of
FLIP's constants changed."""
import json
import os
import pathlib
import subprocess

import flip_evaluator
import numpy as np
import OpenEXR
import PIL.Image
import pytest

BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", pathlib.Path(__file__).parents[1] / "build" / "bin"))
SIZE = (48, 64)   # rows, columns


def write_exr(path, colour, variance=None, **layers):
    """Float32 EXR of (rows, columns, 3) colour, and variance.R, .G, .B where given."""
    channels = {"RGB": np.ascontiguousarray(colour, "f4")}
    for name, values in ([("variance.", variance)] if variance is not None else []):
        channels |= {name + letter: np.ascontiguousarray(values[..., c], "f4") for c, letter in enumerate("RGB")}
    channels |= {name: np.ascontiguousarray(values, "f4") for name, values in layers.items()}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))
    return path


def run(*arguments):
    return subprocess.run([BIN / "selvedge-compare", *map(str, arguments)], capture_output=True, text=True, timeout=60)


def measure(a, b, *arguments):
    """The JSON object of a comparison that gives no verdict."""
    done = run(a, b, "--json", "--fail", "max_abs=inf", *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def rng():
    return np.random.default_rng(20)


@pytest.fixture
def picture(rng):
    """A smooth picture with some detail, linear, some of it dark and some brighter than a display."""
    y, x = np.mgrid[:SIZE[0], :SIZE[1]] / SIZE[1]
    return np.stack([2 * (.5 + .5 * np.sin(20 * x)) ** 2, .3 + .3 * np.cos(31 * x * y), y ** 2], -1) * rng.uniform(.9, 1.1, (*SIZE, 1))


def test_a_constant_difference_has_the_metrics_of_the_formulas(tmp_path):
    b = np.broadcast_to([1.0, 0.5, 0.0], (*SIZE, 3))
    a = np.broadcast_to([1.1, 0.45, 0.0], (*SIZE, 3))
    got = measure(write_exr(tmp_path / "a.exr", a), write_exr(tmp_path / "b.exr", b))
    want = {"rmse": np.sqrt((.01 + .0025) / 3), "relmse": (.01 / 1.01 + .0025 / .26) / 3, "max_abs": .1,
            "mean_relative_bias": .05 / 1.5, "mean_relative_bias.R": .1, "mean_relative_bias.G": -.1, "mean_relative_bias.B": 0}
    for name, value in want.items():
        assert got[name] == pytest.approx(value, rel=2e-6, abs=1e-12), name   # float32 files
    assert got["z_outliers"] is None and got["relmse_noise"] is None
    assert got["size"] == [SIZE[1], SIZE[0]]


def test_metrics_agree_with_numpy(tmp_path, picture, rng):
    a = picture * rng.lognormal(0, .2, picture.shape)
    a[7, 11, 1] += 5
    a, b = (image.astype("f4").astype("f8") for image in (a, picture))
    got = measure(write_exr(tmp_path / "a.exr", a), write_exr(tmp_path / "b.exr", b))
    want = {"rmse": np.sqrt(np.mean((a - b) ** 2)), "relmse": np.mean((a - b) ** 2 / (b ** 2 + .01)),
            "mean_relative_bias": a.sum() / b.sum() - 1, "max_abs": abs(a - b).max()}
    for name, value in want.items():
        assert got[name] == pytest.approx(value, rel=1e-9), name
    assert got["worst_pixel"] == [11, 7]


def display(radiance):
    """Khronos PBR Neutral and sRGB again, in numpy, typed from their specifications."""
    lowest = radiance.min(-1, keepdims=True)
    colour = radiance - np.where(lowest < .08, lowest - 6.25 * lowest ** 2, .04)
    peak = colour.max(-1, keepdims=True)
    over = np.maximum(peak, .76)
    new = 1 - .24 ** 2 / (over + .24 - .76)
    grey = 1 - 1 / (.15 * (over - new) + 1)
    colour = np.where(peak < .76, colour, (1 - grey) * colour * new / over + grey * new)
    return np.where(colour <= .0031308, 12.92 * colour, 1.055 * np.maximum(colour, 1e-9) ** (1 / 2.4) - .055)


@pytest.mark.parametrize("ppd", [67.0206, 25.0])
@pytest.mark.parametrize("change", ["noise", "mirror", "brighter", "shift", "hue", "black"])
def test_flip_agrees_with_its_authors_program(tmp_path, picture, rng, change, ppd):
    b = picture.astype("f4")
    a = {"noise": b * rng.lognormal(0, .3, b.shape), "mirror": b[:, ::-1], "brighter": 1.1 * b, "shift": np.roll(b, 2, 1),
         "hue": b[..., ::-1], "black": 0 * b}[change].astype("f4")
    got = measure(write_exr(tmp_path / "a.exr", a), write_exr(tmp_path / "b.exr", b), "--ppd", ppd)["flip"]
    shown = [display(image.astype("f8")).astype("f4") for image in (b, a)]
    pixels, _, _ = flip_evaluator.evaluate(*shown, "LDR", applyMagma=False, parameters={"ppd": ppd})
    want = pixels.mean(dtype="f8")   # its own mean is a float32 sum, which is 4e-4 off for 60,000 pixels
    assert got == pytest.approx(want, abs=1e-5)
    assert want > .01


def test_flip_sees_the_exposure(tmp_path, picture):
    a, b = write_exr(tmp_path / "a.exr", picture * 1.2), write_exr(tmp_path / "b.exr", picture)
    c, d = write_exr(tmp_path / "c.exr", picture * .6), write_exr(tmp_path / "d.exr", picture * .5)
    assert measure(a, b, "--exposure", -1)["flip"] == pytest.approx(measure(c, d)["flip"], rel=1e-5)


@pytest.fixture
def noisy(tmp_path, picture, rng):
    """noisy(name, scale, factor): the picture with noise of known variance, both scaled; the variance layer times `factor`."""
    sigma = .01 + .1 * picture

    def write(name, scale=1.0, factor=1.0, with_variance=True):
        shape = (4, *SIZE, 3)   # 4 pictures below one another, for narrow statistics: 36,864 values
        image = scale * (picture + sigma * rng.standard_normal(shape)).reshape(-1, SIZE[1], 3)
        variance = np.tile(factor * (scale * sigma) ** 2, (4, 1, 1))
        return write_exr(tmp_path / name, image, variance if with_variance else None)
    return write


def test_noise_alone_gives_a_normal_z(noisy):
    got = measure(noisy("a.exr"), noisy("b.exr"))
    values = 4 * SIZE[0] * SIZE[1] * 3
    assert got["z_values"] == got["values"] == values
    assert got["z_std"] == pytest.approx(1, abs=5 / np.sqrt(2 * values))
    assert got["z_mean"] == pytest.approx(0, abs=5 / np.sqrt(values))
    assert got["z_outliers"] == pytest.approx(.0027, abs=5 * np.sqrt(.0027 / values))
    assert abs(got["mean_relative_bias"]) < 5 * got["mean_relative_bias_sigma"]
    assert got["relmse"] == pytest.approx(got["relmse_noise"], rel=.05)
    assert got["relmse_reference_noise"] == pytest.approx(got["relmse_noise"] / 2, rel=1e-5)   # the sum of two equal parts


def test_a_bias_of_one_percent_is_seen(noisy):
    """1 % is below the noise of any pixel here: it shows in the bias, against its own sigma, and in the mean of z."""
    got = measure(noisy("a.exr", scale=1.01), noisy("b.exr"))
    assert got["mean_relative_bias"] == pytest.approx(.01, abs=4 * got["mean_relative_bias_sigma"])
    assert got["mean_relative_bias"] > 4 * got["mean_relative_bias_sigma"]
    assert got["z_mean"] > 4 / np.sqrt(got["z_values"])


def test_a_bias_of_four_sigma_gives_outliers(noisy, tmp_path, picture):
    exact = write_exr(tmp_path / "exact.exr", np.tile(picture + 4 * (.01 + .1 * picture), (4, 1, 1)))
    got = measure(exact, noisy("b.exr"))   # one variance layer is enough
    assert got["z_outliers"] == pytest.approx(.841, abs=.02)   # P(n > -1)


@pytest.mark.parametrize("factor, std", [(.25, 2), (4, .5)])
def test_a_wrong_variance_shows_in_the_spread_of_z(noisy, factor, std):
    got = measure(noisy("a.exr", factor=factor), noisy("b.exr", factor=factor))
    assert got["z_std"] == pytest.approx(std, rel=.03)


def test_values_without_noise_count_only_where_they_differ(tmp_path):
    a, b, none = np.ones((*SIZE, 3)), np.ones((*SIZE, 3)), np.zeros((*SIZE, 3))
    a[0, 0, 0] += 1e-6    # another device's rounding
    a[1, 1] += .01        # a difference that no noise explains
    got = measure(write_exr(tmp_path / "a.exr", a, none), write_exr(tmp_path / "b.exr", b, none))
    assert (got["z_values"], got["z_outliers"]) == (3, 1)


def test_exit_statuses_are_those_of_idiff(tmp_path, picture):
    b = write_exr(tmp_path / "b.exr", picture)
    a = write_exr(tmp_path / "a.exr", picture * 1.01)
    small = write_exr(tmp_path / "small.exr", picture[:-1])
    assert run(b, b).returncode == 0
    assert run(a, b).returncode == 2   # as idiff: without thresholds nothing may differ
    assert run(a, b, "--fail", "mean_relative_bias=0.02").returncode == 0
    assert run(a, b, "--warn", "mean_relative_bias=0.005", "--fail", "mean_relative_bias=0.02").returncode == 1
    done = run(a, b, "--warn", "flip=1e-9", "--fail", "relmse=1", "--fail", "mean_relative_bias=0.005")
    assert done.returncode == 2
    assert "failure: mean_relative_bias is 0.01, expected at most 0.005" in done.stderr
    assert run(b, a, "--fail", "mean_relative_bias=0.005").returncode == 2   # darker is as wrong as brighter
    done = run(small, b)
    assert (done.returncode, done.stdout) == (3, "")
    assert "found 64 x 47 pixels, expected 64 x 48" in done.stderr
    assert run(a, b, "--fail", "z_outliers=1").returncode == 2   # a threshold on what is not there is not met


def test_json_names_the_verdict_and_nothing_else_is_on_stdout(tmp_path, picture):
    a, b = write_exr(tmp_path / "a.exr", picture * 1.01), write_exr(tmp_path / "b.exr", picture)
    done = run(a, b, "--json")
    report = json.loads(done.stdout)
    assert (done.returncode, report["verdict"], len(report["failed"])) == (2, "failure", 1)
    assert (report["a"], report["b"]) == (str(a), str(b))
    assert json.loads(run(b, b, "--json").stdout)["verdict"] == "same"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["a", "b", "variance"])
def test_a_bad_value_is_a_failure_and_spoils_no_metric(tmp_path, picture, where, value):
    a, b, variance = picture.copy(), picture.copy(), .01 * np.ones_like(picture)
    {"a": a, "b": b, "variance": variance}[where][5, 9, 2] = value
    done = run(write_exr(tmp_path / "a.exr", a, variance), write_exr(tmp_path / "b.exr", b), "--json", "--fail", "flip=1",
               "--heatmap", tmp_path / "map.png")
    report = json.loads(done.stdout)
    assert done.returncode == 2
    assert report["bad_pixels"] == ({"a": 0, "b": 1} if where == "b" else {"a": 1, "b": 0})
    assert "(first bad pixel 9, 5)" in done.stderr
    assert report["rmse"] == 0 and report["values"] == picture.size - 3
    with PIL.Image.open(tmp_path / "map.png") as picture_of_map:
        assert picture_of_map.getpixel((9, 5)) == (0, 255, 0)


def test_a_picture_of_nothing_but_nan_is_a_failure(tmp_path, picture):
    a, b = write_exr(tmp_path / "a.exr", picture * np.nan), write_exr(tmp_path / "b.exr", picture)
    done = run(a, b, "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["rmse"] is None


def test_files_that_cannot_be_compared_are_status_4_and_one_line(tmp_path, picture):
    good = write_exr(tmp_path / "good.exr", picture)
    heatmap = tmp_path / "map.png"
    heatmap.write_bytes(b"as it was")
    whole = good.read_bytes()
    for name, content in {"half.exr": whole[:len(whole) // 2], "head.exr": whole[:40], "empty.exr": b"", "text.exr": b"hello\n"}.items():
        (tmp_path / name).write_bytes(content)
    no_colour = tmp_path / "depth.exr"
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {name: np.ones(SIZE, "f4") for name in ("depth.Z", "u")}).write(str(no_colour))
    some_variance = write_exr(tmp_path / "some.exr", picture, **{"variance.R": picture[..., 0]})
    for bad in [tmp_path / "half.exr", tmp_path / "head.exr", tmp_path / "empty.exr", tmp_path / "text.exr", tmp_path / "none.exr",
                tmp_path, no_colour, some_variance]:
        for pair in [(bad, good), (good, bad)]:
            done = run(*pair, "--json", "--heatmap", heatmap)
            assert (done.returncode, done.stdout) == (4, ""), (bad, done.stderr)
            assert done.stderr.startswith(f"selvedge-compare: {bad}: ") and done.stderr.count("\n") == 1, done.stderr
    assert heatmap.read_bytes() == b"as it was"
    done = run(good, good, "--heatmap", tmp_path / "no" / "such" / "folder.png")
    assert done.returncode == 4 and "no folder" in done.stderr


@pytest.mark.parametrize("arguments, words", [
    ([], "expected two"), (["a.exr"], "expected two"), (["a.exr", "b.exr", "c.exr"], "c.exr"), (["a.exr", "b.exr", "--bogus"], "--bogus"),
    (["a.exr", "b.exr", "--fail", "psnr=3"], "z_outliers"), (["a.exr", "b.exr", "--fail", "flip"], "METRIC=VALUE"),
    (["a.exr", "b.exr", "--warn", "flip=x"], "expected a number"), (["a.exr", "b.exr", "--fail", "flip=-1"], "expected a number"),
    (["a.exr", "b.exr", "--fail", "flip=nan"], "expected a number"), (["a.exr", "b.exr", "--heatmap-kind", "rainbow"], "difference"),
    (["a.exr", "b.exr", "--ppd", "0"], "--ppd"), (["a.exr", "b.exr", "--exposure", "nan"], "--exposure"),
    (["a.exr", "b.exr", "--fail"], "--fail")])
def test_wrong_usage_is_status_2_and_one_line(arguments, words):
    done = run(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("selvedge-compare: ") and done.stderr.count("\n") == 1, done.stderr
    assert words in done.stderr


def test_help_and_version():
    done = run("--help")
    assert done.returncode == 0 and done.stderr == ""
    for word in ("--heatmap", "--fail", "z_outliers", "relmse", "Exit status"):
        assert word in done.stdout
    done = run("-V")
    assert done.returncode == 0 and done.stdout.startswith("selvedge-compare 0.")


def heatmap_of(tmp_path, a, b, kind):
    path = tmp_path / f"{kind}.png"
    measure(a, b, "--heatmap", path, "--heatmap-kind", kind)
    with PIL.Image.open(path) as image:
        assert image.mode == "RGB"
        return np.asarray(image).astype(int)


def test_heat_maps_put_each_error_on_the_ramp(tmp_path):
    b = np.ones((*SIZE, 3))
    a = b.copy()
    weight = np.sqrt(1.01)
    a[:, 32:] = 1 + .0316227766 * weight   # half of the logarithmic ramp: magma's middle is #b73779
    variance = np.full_like(b, (.0316227766 * weight / 2.5) ** 2)
    a_path, b_path = write_exr(tmp_path / "a.exr", a, variance), write_exr(tmp_path / "b.exr", b)
    relative = heatmap_of(tmp_path, a_path, b_path, "relative")
    assert relative.shape == (*SIZE, 3)
    assert (relative[:, :32] == [0, 0, 4]).all() and (abs(relative[:, 32:] - [0xb7, 0x37, 0x79]) <= 1).all()
    z = heatmap_of(tmp_path, a_path, b_path, "z")
    assert (z[:, :32] == 255).all() and (abs(z[0, 40] - [(1 + c) / 2 * 255 for c in (.70, .05, .09)]) <= 1).all()   # 2.5 of 5
    assert (heatmap_of(tmp_path, b_path, a_path, "difference")[0, 40] < 255).all()   # darker: towards blue
    assert heatmap_of(tmp_path, b_path, a_path, "difference")[0, 40].argmax() == 2
    assert (heatmap_of(tmp_path, a_path, b_path, "flip")[:, 0] == [0, 0, 4]).all()


def test_png_is_read_as_srgb_and_grey_as_three_channels(tmp_path):
    PIL.Image.fromarray(np.full((*SIZE, 3), 188, "u1")).save(tmp_path / "a.png")
    PIL.Image.fromarray(np.full(SIZE, 188, "u1")).save(tmp_path / "grey.png")
    linear = ((188 / 255 + .055) / 1.055) ** 2.4
    b = write_exr(tmp_path / "b.exr", np.full((*SIZE, 3), linear))
    assert measure(tmp_path / "a.png", b)["max_abs"] < 1e-6
    assert measure(tmp_path / "grey.png", b)["max_abs"] < 1e-6


def test_sums_do_not_depend_on_the_number_of_threads(tmp_path, noisy):
    a, b = noisy("a.exr"), noisy("b.exr")
    alone = subprocess.run(["taskset", "-c", "0", BIN / "selvedge-compare", a, b, "--json"], capture_output=True, text=True)
    assert json.loads(alone.stdout) == json.loads(run(a, b, "--json").stdout)
