"""Processors have vectors of 16, 8 or 4 floats, and rays go in packets as wide or, of 4, alone (reference/rays.cpp): whatever this machine has,
the narrower ones are tried as well.

Seen red, on a machine without vectors of 16, with packets of 16 in its place, and with crossings of a sheet that a packet of 8 shows twice."""
import os
import subprocess

import numpy as np
import OpenEXR
import pytest

import evaluate

SCENE = evaluate.ROOT / "assets" / "scenes" / "cylinder_satin.json"


def run(isa, *command):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=300, env=os.environ | ({"SELVEDGE_ISA": isa}))
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    return done.stdout


def picture(isa, path, *arguments):
    run(isa, evaluate.BIN / "selvedge-render", SCENE, "-q", "--resolution", "64,64", "--spp", 64, "-o", path, *arguments)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.astype("f8") for name, channel in file.channels().items()}


@pytest.mark.parametrize("isa", ["sse4.2", "avx2"])
@pytest.mark.parametrize("case", ["rays that are traced together*", "light through sheets*"])
def test_rays_have_the_answers_that_they_have_alone(isa, case):
    assert "All tests passed" in run(isa, evaluate.BIN / "selvedge-tests", case)


@pytest.mark.parametrize("isa", ["", "sse4.2", "avx2"])
def test_pictures_do_not_depend_on_which_samples_go_together(tmp_path, isa):
    """All in one pass, and one sample of every pixel in each; and hardly on the processor: its last bits."""
    whole = picture(isa, tmp_path / "whole.exr")
    parts = picture(isa, tmp_path / "parts.exr", "--checkpoint", .001)
    assert all((whole[name] == parts[name]).all() for name in whole)
    other = picture("", tmp_path / "other.exr")
    apart = np.abs(whole["G"] - other["G"]) / (other["G"] + 1e-3)
    assert np.median(apart) < 1e-5 and (apart > 1e-3).mean() < .01   # AVX2 against SSE: 2.6e-4 at most
    assert whole["G"].mean() == pytest.approx(other["G"].mean(), rel=1e-4)


def test_an_unknown_instruction_set_is_refused(tmp_path):
    done = subprocess.run([evaluate.BIN / "selvedge-render", SCENE, "-o", tmp_path / "a.exr", "--spp", "1"], capture_output=True, text=True, timeout=60,
                          env=os.environ | {"SELVEDGE_ISA": "avx3"})
    assert done.returncode == 1 and "found 'avx3', expected sse4.2, avx, avx2 or avx512" in done.stderr and not (tmp_path / "a.exr").exists()
