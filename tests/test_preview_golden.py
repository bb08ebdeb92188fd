"""The preview's pictures of our scenes against golden ones, noise told from change by the variance of both. On failure a picture of the
difference lies in out/golden/.

Seen red with the light of a sun halved, and with the horizons of the other side."""
import json
import subprocess

import pytest

import evaluate
import goldens

OUT = evaluate.ROOT / "out" / "golden"


def compare(picture, golden, name):
    """selvedge-compare's figures; leaves the heat map in OUT only where they are bad."""
    OUT.mkdir(parents=True, exist_ok=True)
    heat = OUT / f"{name}.png"
    done = subprocess.run([evaluate.BIN / "selvedge-compare", picture, golden, "--json", "--fail", "max_abs=inf", "--heatmap", heat],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), heat


@pytest.mark.parametrize("name", goldens.NAMES)
def test_the_picture_is_the_golden_one(program, tmp_path, name):
    """16 blocks against a long render: Student's t with 15 degrees of freedom, of which 0.9 % lie beyond 3; 1,024 pixels, three standard
    deviations more. Eight points a frame, so that a block has 128: the mean of fewer is so skewed where light is rare that its variance
    goes with it (one point a frame: z of -0.2 in the mean and 2.4 % beyond 3, though 6,656 frames show no bias)."""
    picture = tmp_path / "a.exr"
    subprocess.run([program("lookdev"), goldens.scene(name), "--headless", "-o", picture, "--frames", "256", "--footprint-samples", "8",
                    "--seed", "3", "-q", "--resolution", f"{goldens.SIZE},{goldens.SIZE}"], check=True, timeout=300)
    found, heat = compare(picture, goldens.FOLDER / f"{name}.exr", name)
    good = found["z_outliers"] < 0.018 and 0.85 < found["z_std"] < 1.25
    good = good and all(abs(found[f"mean_relative_bias.{c}"]) < 0.002 + 3 * found["mean_relative_bias_sigma"] for c in "RGB")
    assert good, f"another picture; where: {heat}; remade, if it is meant to be, by tests/goldens.py\n{found}"
    heat.unlink()
