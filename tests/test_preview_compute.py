"""Compute shaders in place of fragment shaders: the same text, so on software GL the same bits.

Seen red with a pixel's corner in place of its centre, and with rows and columns of tiles exchanged. That finished tiles are left out is no
matter of the picture: their work is what is saved."""
import numpy as np
import pytest

from test_preview import SCENES, lookdev, read, render
from test_preview_gl import OLD

SIZE = ["--resolution", "56,40"]
CASES = {"one": ("layers", ["--frames", 8]), "several": ("layers", ["--frames", 4, "--footprint-samples", 4]),
         "rays": ("layers", ["--frames", 8, "--primary", "rays"]), "tiles": ("cylinder_satin", ["--target-error", 5e-4]),
         "paths": ("curtain", ["--frames", 4, "--integrator", "path"]), "matte": ("sphere_matte", ["--frames", 8])}


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
@pytest.mark.parametrize("case", CASES)
def test_compute_shaders_draw_the_same_bits(tmp_path, case, backend):
    scene, arguments = CASES[case]
    reports = {shade: render(SCENES / f"{scene}.json", tmp_path / f"{shade}.exr", *SIZE, *arguments, "--backend", backend, "--shade", shade)
               for shade in ("fragment", "compute")}
    assert [name for name in reports["fragment"]["passes"] if name.endswith("-compute")] == []
    shading = "shade-rays" if "shade-rays" in reports["fragment"]["passes"] else "shade"
    assert shading + "-compute" in reports["compute"]["passes"]
    (a, _), (b, _) = (read(tmp_path / f"{shade}.exr") for shade in ("fragment", "compute"))
    assert (len(np.unique(a["samples"])) > 3) == (case == "tiles")   # some of them stop before others
    assert a.keys() == b.keys() and all((a[name] == b[name]).all() for name in a)
    assert a["G"].max() > 0


def test_software_gl_draws_fragments_unless_asked(tmp_path):
    assert "shade" in render(SCENES / "sphere_matte.json", tmp_path / "a.exr", *SIZE, "--frames", 1)["passes"]


def test_a_driver_without_compute_shaders_says_so(tmp_path):
    done = lookdev(SCENES / "sphere_matte.json", "--headless", "-o", tmp_path / "a.exr", "--frames", 1, "--shade", "compute", status=1, environment=OLD)
    assert done.stderr.count("\n") == 1 and "GL 4.3" in done.stderr and "4.1" in done.stderr and not (tmp_path / "a.exr").exists()
    assert "--shade" in lookdev(SCENES / "sphere_matte.json", "--headless", "-o", tmp_path / "a.exr", "--frames", 1, "--shade", "fast", status=2).stderr
