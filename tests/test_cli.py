"""What people's mistakes get from the four programs: one clear line, exit status 1 or 2, and no file touched."""
import json
import pathlib
import shutil
import struct
import subprocess

import numpy as np
import PIL.Image
import pytest

import evaluate

PROGRAMS = ("bake", "render", "lookdev", "compare")
ASSETS = evaluate.ROOT / "assets"
OLD = b"what was here before"
WIF = """[WIF]
Version=1.1
Developers=wif@mhsoft.com
Source Program=test
[CONTENTS]
WEAVING=true
THREADING=true
TIEUP=true
TREADLING=true
WARP=true
WEFT=true
[WEAVING]
Shafts=2
Treadles=2
Rising Shed=true
[WARP]
Threads=2
[WEFT]
Threads=2
[THREADING]
1=1
2=2
[TIEUP]
1=1
2=2
[TREADLING]
1=1
2=2
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
FABRIC = {"name": "test", "pattern": "plain 1/1", "resolution": 64, "warp": {"spacing": 0.0005}, "weft": {"spacing": 0.0005}}


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Bakes of the tests neither use nor fill the person's cache."""
    monkeypatch.setenv("SELVEDGE_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


def scene(**changes):
    return {"camera": {"position": [0, 1, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 35}, "film": {"resolution": [16, 16]},
            "lights": [{"type": "directional", "direction": [0, -1, 0], "irradiance": [3, 3, 3]}],
            "objects": [{"mesh": "mesh.obj", "fabric": "fabric.json"}]} | changes


@pytest.fixture
def folder(tmp_path):
    """A scene that works: each test breaks one thing of it."""
    (tmp_path / "scene.json").write_text(json.dumps(scene(), indent=1))
    (tmp_path / "fabric.json").write_text(json.dumps(FABRIC, indent=1))
    (tmp_path / "mesh.obj").write_text(OBJ)
    (tmp_path / "draft.wif").write_text(WIF)
    for name in ("out.exr", "out.png", "heat.png"):
        (tmp_path / name).write_bytes(OLD)
    return tmp_path


def call(verb, folder, *arguments, timeout=120):
    return subprocess.run([evaluate.BIN / f"selvedge-{verb}", *map(str, arguments)], cwd=folder, capture_output=True, text=True, timeout=timeout)


def good_arguments(verb, scene_name="scene.json"):
    return {"bake": [scene_name.replace("scene", "fabric"), "--preview", "out.png"],
            "render": [scene_name, "-o", "out.exr", "--spp", "1"],
            "lookdev": [scene_name, "--headless", "-o", "out.exr", "--frames", "1", "--backend", "osmesa"],
            "compare": ["a.exr", "b.exr", "--heatmap", "heat.png"]}[verb]


def listing(folder):
    return {path.relative_to(folder): (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


def refuses(verb, folder, arguments, statuses, *words):
    """Runs a program that must fail: its status, one line on stderr that starts with its name and holds `words`, nothing on
    stdout, no file made, changed or removed."""
    before = listing(folder)
    done = call(verb, folder, *arguments)
    said = done.stderr.splitlines()
    assert done.returncode in statuses, f"exit status {done.returncode}: {done.stderr}"
    assert len(said) == 1, f"{len(said)} lines:\n{done.stderr}"
    assert said[0].startswith(f"selvedge-{verb}: "), said[0]
    assert done.stdout == ""
    assert listing(folder) == before, "files were touched"
    for word in words:
        assert word in said[0], f"{word!r} is not in: {said[0]}"
    return said[0]


# ---- what every program does -------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("verb", PROGRAMS)
@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_names_the_options(verb, option, folder):
    done = call(verb, folder, option)
    assert done.returncode == 0 and done.stderr == ""
    assert "--json" in done.stdout and "--version" in done.stdout and "--quiet" in done.stdout


@pytest.mark.parametrize("verb", PROGRAMS)
@pytest.mark.parametrize("option", ["-V", "--version"])
def test_version_names_the_program_and_its_revision(verb, option, folder):
    done = call(verb, folder, option)
    assert done.returncode == 0
    assert done.stdout.startswith(f"selvedge-{verb} ") and "git " in done.stdout


@pytest.mark.parametrize("verb", PROGRAMS)
def test_unknown_option_is_refused(verb, folder):
    refuses(verb, folder, [*good_arguments(verb), "--no-such-option"], [2], "--no-such-option")


@pytest.mark.parametrize("verb", PROGRAMS)
def test_no_arguments_are_refused(verb, folder):
    refuses(verb, folder, [], [2], "--help")


@pytest.mark.parametrize("verb, arguments", [
    ("bake", ["--resolution", "many"]), ("bake", ["--resolution", "-5"]), ("bake", ["--visibility", "sometimes"]), ("bake", ["--resolution"]),
    ("render", ["--spp", "0"]), ("render", ["--spp", "x"]), ("render", ["--integrator", "guess"]), ("render", ["--resolution", "16x16"]),
    ("render", ["--mode", "theirs"]), ("render", ["--threads", "-1"]), ("render", ["--region", "0,0,99,99"]), ("render", ["--aov", "taste"]),
    ("render", ["-D", "film.no_such_key=1"]), ("render", ["-D", "nonsense"]), ("render", ["--time", "nan"]),
    ("lookdev", ["--frames", "-1"]), ("lookdev", ["--frames", "1e3"]), ("lookdev", ["--backend", "metal"]), ("lookdev", ["--bsdf", "nano"]),
    ("lookdev", ["--resolution", "0,16"]), ("compare", ["--fail", "beauty=1"]), ("compare", ["--fail", "rmse"]), ("compare", ["--fail", "rmse=x"]),
], ids=lambda v: v if isinstance(v, str) else " ".join(v))
def test_unknown_values_are_refused(verb, arguments, folder):
    write_pictures(folder)
    refuses(verb, folder, [*good_arguments(verb), *arguments], [1, 2])


@pytest.mark.parametrize("verb", PROGRAMS)
def test_json_is_one_object_and_nothing_else(verb, folder):
    write_pictures(folder)
    done = call(verb, folder, *good_arguments(verb), "--json", "-q")
    assert done.returncode in ((0, 1, 2) if verb == "compare" else (0,)), done.stderr
    assert isinstance(json.loads(done.stdout), dict)
    # compare's verdict is no progress: it is told in any case.
    assert done.stderr == "" or verb == "compare" and "failure: " in done.stderr


def test_json_has_the_promised_fields(folder):
    bake = json.loads(call("bake", folder, *good_arguments("bake"), "--json").stdout)
    assert {"fabric", "texels", "seconds", "bytes", "visibility", "cached", "coverage", "warnings"} <= set(bake)
    assert {"pattern", "maps", "visibility", "normals", "total"} <= set(bake["seconds"])
    assert {"memory", "disk"} <= set(bake["bytes"]) and {"warp", "weft", "gap"} <= set(bake["coverage"])
    assert {"kind", "bytes_per_texel", "rms_error", "directions"} <= set(bake["visibility"])
    for verb in ("render", "lookdev"):
        report = json.loads(call(verb, folder, *good_arguments(verb), "--json").stdout)
        assert {"seconds", "samples", "spp_mean", "rays", "error_estimate", "peak_rss_bytes", "skipped"} <= set(report)
        assert {"load", "bake", "build", "render"} <= set(report["seconds"])
    assert {"gl", "frames", "milliseconds_per_frame", "features", "passes"} <= set(report)
    assert {"renderer", "version", "backend"} <= set(report["gl"]) and {"median", "p95"} <= set(report["milliseconds_per_frame"])


def test_unchanged_fabric_costs_no_bake(folder):
    assert not json.loads(call("bake", folder, "fabric.json", "--json", "--force").stdout)["cached"]
    assert json.loads(call("bake", folder, "fabric.json", "--json").stdout)["cached"]


# ---- files that are not there, or not what they should be ---------------------------------------------------------------------------

@pytest.mark.parametrize("verb", PROGRAMS)
def test_missing_file_is_refused(verb, folder):
    arguments = {"compare": ["nowhere.exr", "out.exr", "--heatmap", "heat.png"]}.get(verb, good_arguments(verb, "no_scene.json"))
    refuses(verb, folder, arguments, [4] if verb == "compare" else [1], "no_fabric.json" if verb == "bake" else "nowhere.exr" if verb == "compare" else "no_scene.json")


@pytest.mark.parametrize("verb", ["bake", "render", "lookdev"])
def test_folder_in_place_of_a_file_is_refused(verb, folder):
    (folder / "scene.json").unlink()
    (folder / "fabric.json").unlink()
    (folder / "scene.json").mkdir()
    (folder / "fabric.json").mkdir()
    refuses(verb, folder, good_arguments(verb), [1])


BROKEN_JSON = {
    "cut_off": ('{"camera": {"position": [0, 1,', 1), "comma": ('{\n"name": "x",\n}', 3), "empty": ("", None), "no_object": ("[1, 2]", None),
    "binary": ("\x00\x01\x02", None), "twice": ('{"name": "a"} {}', 1), "deep": ("[" * 100_000, None),
}


@pytest.mark.parametrize("verb", ["bake", "render", "lookdev"])
@pytest.mark.parametrize("kind", BROKEN_JSON)
def test_broken_json_is_refused_with_its_line(verb, kind, folder):
    text, line = BROKEN_JSON[kind]
    name = "fabric.json" if verb == "bake" else "scene.json"
    (folder / name).write_text(text)
    refuses(verb, folder, good_arguments(verb), [1], name if line is None else f"{name}:{line}:")


BAD_SCENES = {
    "unknown_key": (scene(weather="fine"), "weather"),
    "number_for_list": (scene(camera={"position": 3}), "position"),
    "short_list": (scene(film={"resolution": [16]}), "resolution"),
    "negative_resolution": (scene(film={"resolution": [-16, 16]}), "resolution"),
    "huge_resolution": (scene(film={"resolution": [10**9, 10**9]}), "resolution"),
    "light_kind": (scene(lights=[{"type": "candle"}]), "candle"),
    "light_without_direction": (scene(lights=[{"type": "directional", "irradiance": [1, 1, 1]}]), "direction"),
    "zero_direction": (scene(lights=[{"type": "directional", "direction": [0, 0, 0], "irradiance": [1, 1, 1]}]), "direction"),
    "negative_irradiance": (scene(lights=[{"type": "directional", "direction": [0, -1, 0], "irradiance": [-1, 1, 1]}]), "irradiance"),
    "missing_image": (scene(lights=[{"type": "environment", "image": "nowhere.exr"}]), "nowhere.exr"),
    "missing_mesh": (scene(objects=[{"mesh": "nowhere.obj", "fabric": "fabric.json"}]), "nowhere.obj"),
    "missing_fabric": (scene(objects=[{"mesh": "mesh.obj", "fabric": "nowhere.json"}]), "nowhere.json"),
    "unknown_shape": (scene(objects=[{"shape": "dodecahedron", "fabric": "fabric.json"}]), "dodecahedron"),
    "camera_inside_target": (scene(camera={"position": [0, 0, 0], "target": [0, 0, 0]}), "camera"),
    "wide_fov": (scene(camera={"position": [0, 1, 3], "target": [0, 0, 0], "fov": 200}), "fov"),
    "zero_uv_scale": (scene(objects=[{"mesh": "mesh.obj", "fabric": "fabric.json", "uv_scale": 0}]), "uv_scale"),
}


@pytest.mark.parametrize("verb", ["render", "lookdev"])
@pytest.mark.parametrize("kind", BAD_SCENES)
def test_bad_scene_is_refused_with_its_key(verb, kind, folder):
    value, word = BAD_SCENES[kind]
    (folder / "scene.json").write_text(json.dumps(value, indent=1))
    refuses(verb, folder, good_arguments(verb), [1], word)


BAD_FABRICS = {
    "unknown_pattern": (FABRIC | {"pattern": "tartan"}, "tartan"), "unknown_key": (FABRIC | {"colour": "red"}, "colour"),
    "negative_spacing": (FABRIC | {"warp": {"spacing": -1}}, "spacing"), "zero_spacing": (FABRIC | {"warp": {"spacing": 0}}, "spacing"),
    "text_for_number": (FABRIC | {"weft": {"plies": "two"}}, "plies"), "huge_resolution": (FABRIC | {"resolution": 10**9}, "resolution"),
    "albedo_above_one": (FABRIC | {"warp": {"albedo": [2, 0, 0]}}, "albedo"), "missing_wif": (FABRIC | {"pattern": {"wif": "nowhere.wif"}}, "nowhere.wif"),
}


@pytest.mark.parametrize("kind", BAD_FABRICS)
def test_bad_fabric_is_refused_with_its_key(kind, folder):
    value, word = BAD_FABRICS[kind]
    (folder / "fabric.json").write_text(json.dumps(value, indent=1))
    refuses("bake", folder, good_arguments("bake"), [1], word)
    refuses("render", folder, good_arguments("render"), [1], word)


BROKEN_WIFS = {
    "empty": "", "no_wif": "hello\nworld\n", "cut_off": WIF[:WIF.index("[THREADING]")], "html": "<html><body>404</body></html>",
    "threads_are_text": WIF.replace("[WARP]\nThreads=2", "[WARP]\nThreads=many"), 
    "huge": WIF.replace("[WARP]\nThreads=2", "[WARP]\nThreads=2000000000"), "negative": WIF.replace("[WEFT]\nThreads=2", "[WEFT]\nThreads=-2"),
    "binary": WIF[:80] + "\0\1\2" * 50,
}


@pytest.mark.parametrize("kind", BROKEN_WIFS)
def test_broken_wif_is_refused(kind, folder):
    (folder / "draft.wif").write_text(BROKEN_WIFS[kind])
    refuses("bake", folder, ["draft.wif", "--preview", "out.png"], [1], "draft.wif")
    (folder / "fabric.json").write_text(json.dumps(FABRIC | {"pattern": {"wif": "draft.wif"}}))
    refuses("render", folder, good_arguments("render"), [1], "draft.wif")


def test_good_wif_is_baked(folder):
    done = call("bake", folder, "draft.wif", "--json")
    assert done.returncode == 0, done.stderr


BROKEN_MESHES = {
    "no_uvs": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "empty": "", "no_faces": "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n",
    "text": "this is no mesh\n", "all_degenerate": "v 0 0 0\nv 0 0 0\nv 0 0 0\nvt 0 0\nf 1/1 2/1 3/1\n",
}


@pytest.mark.parametrize("verb", ["render", "lookdev"])
@pytest.mark.parametrize("kind", BROKEN_MESHES)
def test_broken_mesh_is_refused(verb, kind, folder):
    (folder / "mesh.obj").write_text(BROKEN_MESHES[kind])
    refuses(verb, folder, good_arguments(verb), [1], "mesh.obj")


def write_hdr(path, size=(32, 16), keep=1.0):
    """Flat Radiance picture, without run lengths; `keep` cuts the file."""
    w, h = size
    data = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {h} +X {w}\n".encode() + bytes([128, 128, 128, 129]) * (w * h)
    path.write_bytes(data[:int(len(data) * keep)])


def write_pictures(folder):
    """Two small EXR files for selvedge-compare."""
    import OpenEXR
    rng = np.random.default_rng(1)
    for name in ("a.exr", "b.exr"):
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": rng.random((16, 16, 3)).astype("f4")}).write(str(folder / name))


def cut(path, share):
    data = path.read_bytes()
    path.write_bytes(data[:int(len(data) * share)])


BROKEN_IMAGES = {
    "cut_hdr": ("sky.hdr", lambda p: write_hdr(p, keep=0.6)), "cut_hdr_header": ("sky.hdr", lambda p: p.write_bytes(b"#?RADIANCE\n")),
    "empty": ("sky.exr", lambda p: p.write_bytes(b"")), "text": ("sky.exr", lambda p: p.write_text("not a picture")),
    "exr_magic_only": ("sky.exr", lambda p: p.write_bytes(struct.pack("<I", 20000630) + b"\2\0\0\0")),
    "unknown_kind": ("sky.xyz", lambda p: p.write_text("?")),
}


@pytest.mark.parametrize("verb", ["render", "lookdev"])
@pytest.mark.parametrize("kind", BROKEN_IMAGES)
def test_broken_environment_is_refused(verb, kind, folder):
    name, write = BROKEN_IMAGES[kind]
    write(folder / name)
    (folder / "scene.json").write_text(json.dumps(scene(lights=[{"type": "environment", "image": name}])))
    refuses(verb, folder, good_arguments(verb), [1], name)


@pytest.mark.parametrize("verb", ["render", "lookdev"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_truncated_exr_is_refused(verb, share, folder):
    shutil.copy(ASSETS / "lights" / "sky.exr", folder / "sky.exr")
    cut(folder / "sky.exr", share)
    (folder / "scene.json").write_text(json.dumps(scene(lights=[{"type": "environment", "image": "sky.exr"}])))
    refuses(verb, folder, good_arguments(verb), [1], "sky.exr")


def test_truncated_picture_is_refused_by_compare(folder):
    write_pictures(folder)
    cut(folder / "a.exr", 0.5)
    refuses("compare", folder, good_arguments("compare"), [4], "a.exr")


@pytest.mark.parametrize("verb", ["render", "lookdev"])
@pytest.mark.parametrize("output", ["nowhere/out.exr", "out.bmp3", "mesh.obj/out.exr"])
def test_output_that_cannot_be_written_is_refused_before_rendering(verb, output, folder):
    arguments = [output if a == "out.exr" else a for a in good_arguments(verb)]
    arguments = ["1000000" if a == "1" else a for a in arguments]      # a render would not end in time
    refuses(verb, folder, arguments, [1, 2], output.split("/")[0])


def test_render_replaces_a_file_as_a_whole(folder):
    for verb in ("render", "lookdev"):
        (folder / "out.exr").write_bytes(OLD)
        before = set(listing(folder))
        done = call(verb, folder, *good_arguments(verb))
        assert done.returncode == 0, done.stderr
        assert (folder / "out.exr").read_bytes()[:4] == struct.pack("<I", 20000630)
        assert set(listing(folder)) == before, "something was left beside the output"


def test_png_output_goes_through_the_display_transform(folder):
    done = call("render", folder, "scene.json", "-o", "out.png", "-o", "out.exr", "--spp", "4")
    assert done.returncode == 0, done.stderr
    import OpenEXR
    colour = OpenEXR.File(str(folder / "out.exr")).channels()["RGBA"].pixels[..., :3].astype("f8")
    import cloth_oracle
    want = cloth_oracle.srgb(cloth_oracle.tone_neutral(np.maximum(colour, 0)))
    got = np.asarray(PIL.Image.open(folder / "out.png").convert("RGB")) / 255
    assert np.abs(got - want).max() < 1.5 / 255


# ---- files of other people -------------------------------------------------------------------------------------------------------------

def shared_files(kind, *suffixes):
    from conftest import DATA
    return sorted(path.name for path in (DATA / kind).glob("*") if path.suffix in suffixes) if DATA.is_dir() else []


def answers(verb, folder, arguments):
    """Done, or refused in one line; never a crash, a hang, or half a file."""
    before = listing(folder)
    done = call(verb, folder, *arguments)
    if done.returncode == 0:
        return True
    assert done.returncode == 1, f"exit status {done.returncode}: {done.stderr[-500:]}"
    lines = [line for line in done.stderr.splitlines() if ": warning: " not in line]
    assert len(lines) == 1 and lines[0].startswith(f"selvedge-{verb}: "), done.stderr
    assert listing(folder) == before
    return False


@pytest.mark.shared_data
@pytest.mark.parametrize("name", shared_files("wif_malformed", ".wif"))
def test_malformed_wif_of_others_gets_an_answer(name, folder, shared_data):
    answers("bake", folder, [shared_data / "wif_malformed" / name, "--resolution", "64"])


@pytest.mark.shared_data
@pytest.mark.parametrize("name", shared_files("mesh_malformed", ".obj", ".ply", ".glb", ".gltf"))
def test_malformed_mesh_of_others_gets_an_answer(name, folder, shared_data):
    (folder / "scene.json").write_text(json.dumps(scene(objects=[{"mesh": str(shared_data / "mesh_malformed" / name), "fabric": "fabric.json"}])))
    answers("render", folder, good_arguments("render"))


@pytest.mark.shared_data
def test_truncated_hdr_of_others_is_refused(folder, shared_data):
    (folder / "scene.json").write_text(json.dumps(scene(lights=[{"type": "environment", "image": str(shared_data / "hdr" / "d_truncated.hdr")}])))
    refuses("render", folder, good_arguments("render"), [1], "d_truncated.hdr")


def test_the_folder_of_the_tests_is_left_as_it_was():
    """Outputs go to folders of pytest's: none of the above may leave anything in the tree."""
    assert not list(pathlib.Path(evaluate.ROOT / "tests").glob("*.exr")) and not list(evaluate.ROOT.glob("*.png"))
