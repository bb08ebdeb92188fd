"""Turntables, numbered pictures, and the display transform that the environment asks for.

Seen red with objects and with an environment that turn the other way around, and without the exposure."""
import json
import os
import subprocess

import numpy as np
import OpenEXR
import PIL.Image
import pytest

import cloth_oracle as oracle
import evaluate

SCENE = {"film": {"resolution": [24, 24]}, "camera": {"position": [0, 1, 3], "target": [0.1, 0, 0], "fov": 30},
         "lights": [{"type": "environment", "colour": [0.3, 0.4, 0.5]}, {"type": "point", "position": [0.1, 2, 0], "intensity": 3}],
         "objects": [{"shape": "cylinder", "scale": [0.3, 0.8, 0.2], "translate": [0.4, 0, 0.1], "metal": {"roughness": 0.4}},
                     {"shape": "plane", "scale": 2, "translate": [0, -0.4, 0]},
                     {"shape": "sphere", "scale": 0.1, "translate": [0.1, 0.2, 0.0], "emission": [2, 1, 0]}]}


def write(folder, scene):
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder / "scene.json"


def render(folder, scene, name, *options):
    return subprocess.run([evaluate.BIN / "selvedge-render", write(folder, scene), "-o", folder / name, "-q", "--json", *map(str, options)],
                          capture_output=True, text=True, timeout=120)


def picture(folder, scene, name, *options, frame=None):
    done = render(folder, scene, f"{name}.exr", *options)
    assert done.returncode == 0, done.stderr
    path = folder / (f"{name}.exr" if frame is None else f"{name}_{frame:04d}.exr")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {key: channel.pixels.astype("f8") for key, channel in file.channels().items()}


def assert_equal_in_the_mean(one, other):
    """Z of every pixel: their squares average to 1, and few are beyond 4."""
    z = (one["G"] - other["G"]) / np.sqrt(np.maximum(one["variance.G"] + other["variance.G"], 1e-12))
    assert (z**2).mean() < 1.5 and (np.abs(z) > 4.5).mean() < 0.005, ((z**2).mean(), np.abs(z).max())


def test_turning_the_objects_is_turning_the_camera_the_other_way(tmp_path):
    """All lights lie on the axis."""
    for frame in (1, 2):
        objects = picture(tmp_path, SCENE, "a", "--spp", 256, "--turntable", 8, "--frames", f"{frame}-{frame}", frame=frame)
        camera = picture(tmp_path, SCENE, "b", "--spp", 256, "--turntable", 8, "--turn", "camera", "--frames", f"{8 - frame}-{8 - frame}",
                         "--seed", 3, frame=8 - frame)
        assert_equal_in_the_mean(objects, camera)
        still = picture(tmp_path, SCENE, "c", "--spp", 256, "--seed", 4)
        z = (objects["G"] - still["G"]) / np.sqrt(objects["variance.G"] + still["variance.G"] + 1e-12)
        assert (z**2).mean() > 5, "nothing has turned"


def test_turning_the_lights_is_turning_the_camera_the_other_way(tmp_path):
    """All objects are bodies of revolution about the axis; lights of every kind, and an environment with a bright side."""
    sky = np.full((16, 32, 3), 0.1, "f4")
    sky[:, 3:9] = 1
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": sky}).write(str(tmp_path / "sky.exr"))
    aim = {"target": [0.1, 0, 0]}
    scene = SCENE | {"objects": [{"shape": "sphere", "scale": 0.5, "translate": [0.1, 0, 0]},
                                 {"shape": "sphere", "scale": 0.2, "translate": [1.1, 0.7, 0.2], "emission": 4}],
                     "lights": [{"type": "environment", "image": "sky.exr", "visible": False},
                                {"type": "directional", "direction": [-1, -1, 0], "irradiance": 1},
                                {"type": "point", "position": [-1, 1, 1], "intensity": 1},
                                {"type": "spot", "position": [0, 1, -2], "intensity": 5, **aim},
                                {"type": "flash", "position": [2, 0, 0], "intensity": 2, **aim},
                                {"type": "area", "position": [0, 0, 2.5], "size": [0.4, 0.2], "radiance": 20, "visible": True, **aim}]}
    scene["camera"] = {"position": [0.1, 4, 0.5], "target": [0.1, 0, 0], "up": [1, 0, 0], "fov": 18}
    lights = picture(tmp_path, scene, "a", "--spp", 256, "--turntable", 8, "--turn", "lights", "--frames", "1-1", frame=1)
    camera = picture(tmp_path, scene, "b", "--spp", 256, "--turntable", 8, "--turn", "camera", "--frames", "7-7", "--seed", 3, frame=7)
    assert_equal_in_the_mean(lights, camera)


def test_a_sequence_holds_the_pictures_that_one_would_make_alone(tmp_path):
    report = json.loads(render(tmp_path, SCENE, "s.exr", "--spp", 4, "--frames", "2-3", "-D", "camera.fov={frame}0").stdout)
    assert [picture["output"][0][-10:] for picture in report["pictures"]] == ["s_0002.exr", "s_0003.exr"]
    for frame in (2, 3):
        alone = picture(tmp_path, SCENE, f"s{frame}", "--spp", 4, "-D", f"camera.fov={frame}0")
        with OpenEXR.File(str(tmp_path / f"s_000{frame}.exr"), separate_channels=True) as file:
            assert all(np.array_equal(alone[name], channel.pixels) for name, channel in file.channels().items())
    first = picture(tmp_path, SCENE, "t", "--spp", 4, "--turntable", 3, "--frames", "0-0", frame=0)
    still = picture(tmp_path, SCENE, "u", "--spp", 4)
    assert all(np.array_equal(first[name], still[name]) for name in still)


def test_a_number_with_digits_names_files(tmp_path):
    for frame in (7, 8):
        (tmp_path / f"cloth_{frame:04d}.obj").write_text(f"v 0 0 0\nv {frame} 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = SCENE | {"objects": [{"mesh": "none.obj"}]}
    done = render(tmp_path, scene, "s.exr", "--spp", 1, "--frames", "7-8", "-D", "objects.0.mesh=cloth_{frame:4}.obj")
    assert done.returncode == 0 and len(json.loads(done.stdout)["pictures"]) == 2, done.stderr


@pytest.mark.parametrize("options, words", [
    (["--frames", "0-3"], "--frames without --turntable"), (["--turntable", "4", "--frames", "2-4"], "expected frames 0 to 3"),
    (["--turn", "camera"], "--turn without --turntable"), (["--turntable", "4", "--turn", "sun"], "expected one of objects, camera, lights"),
    (["--turntable", "0"], "--turntable"), (["--turntable", "4", "--frames", "3-2"], "expected FIRST-LAST"),
    (["--turntable", "4", "--frames", "1"], "expected FIRST-LAST"), (["-D", "camera.fov={frame}0"], "without --frames")])
def test_sequences_that_cannot_be_are_wrong_usage(tmp_path, options, words):
    done = render(tmp_path, SCENE, "s.exr", *options)
    assert done.returncode == 2 and words in done.stderr and done.stderr.count("\n") == 1, done.stderr


# ---- display ----------------------------------------------------------------------------------------------------------------------

CONFIG = """ocio_profile_version: 1
roles:
  default: {space}
  scene_linear: {space}
displays:
  screen:
    - !<View> {{name: plain, colorspace: shown}}
colorspaces:
  - !<ColorSpace> {{name: {space}}}
  - !<ColorSpace>
    name: shown
    from_reference: !<MatrixTransform> {{matrix: [0.5, 0, 0, 0, 0, 0.25, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}
"""
SKY = {"film": {"resolution": [4, 4]}, "lights": [{"type": "environment", "colour": [0.4, 0.4, 0.2]}]}


def png(folder, program, *options, environment=None):
    verb = ["selvedge-render", "--spp", "1"] if program == "render" else ["selvedge-lookdev", "--headless", "--frames", "1"]
    done = subprocess.run([evaluate.BIN / verb[0], write(folder, SKY), *verb[1:], "-o", folder / "out.png", "-q", *options],
                          capture_output=True, text=True, env=os.environ | (environment or {}), timeout=120)
    return done


def code_values(path):
    """r, g, b of the first pixel, and the texts of the file."""
    with PIL.Image.open(path) as image:
        return np.asarray(image)[0, 0, :3].tolist(), image.info


@pytest.mark.parametrize("program", ["render", "lookdev"])
@pytest.mark.parametrize("space", ["Utility - Linear - sRGB", "working"])
def test_pictures_go_through_the_configuration_that_ocio_names(tmp_path, program, space):
    (tmp_path / "config.ocio").write_text(CONFIG.format(space=space))
    done = png(tmp_path, program, "-D", "film.exposure=1", environment={"OCIO": str(tmp_path / "config.ocio")})
    assert done.returncode == 0, done.stderr
    values, texts = code_values(tmp_path / "out.png")
    assert values == [round(255 * v) for v in (0.8 * 0.5, 0.8 * 0.25, 0.4)], values
    assert texts["selvedge:display"] == f"OpenColorIO {tmp_path}/config.ocio: screen, plain, from {space}"


def test_without_ocio_the_default_is_the_curve_of_the_shared_source(tmp_path):
    done = png(tmp_path, "render", environment={"OCIO": ""})
    assert done.returncode == 0, done.stderr
    values, texts = code_values(tmp_path / "out.png")
    assert values == np.rint(255 * oracle.srgb(oracle.tone_neutral(np.array([[0.4, 0.4, 0.2]]))))[0].tolist()
    assert texts["selvedge:display"] == "Khronos PBR Neutral, sRGB"


@pytest.mark.parametrize("program", ["render", "lookdev"])
@pytest.mark.parametrize("text", [None, "this is no configuration", "ocio_profile_version: 1\nroles: {}\n"], ids=["missing", "broken", "empty"])
def test_a_configuration_that_says_nothing_is_told_before_any_work(tmp_path, program, text):
    if text is not None:
        (tmp_path / "config.ocio").write_text(text)
    done = png(tmp_path, program, environment={"OCIO": str(tmp_path / "config.ocio")})
    assert done.returncode == 1 and "config.ocio" in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert not (tmp_path / "out.png").exists()
