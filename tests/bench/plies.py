"""Suite plies: how far each mode of the surface model is from the plies themselves. Run by ./dev bench plies.

One quiet rerun of everything: ./dev bench plies && build/venv/bin/python tests/bench_report.py"""
import argparse
import json
import math
import pathlib
import sys
import tempfile

import numpy as np
import OpenEXR
from PIL import Image

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
from bench_report import figure  # noqa: E402

FABRICS = {"plain": "plain", "satin": "satin", "twill": "twill", "jersey": "cotton_jersey"}
# By name: what selvedge-render is told. "unstacked": ours, but light that has crossed one yarn meets no other.
MODES = {"ours": ("--mode", "ours"), "unstacked": ("-D", "model.stacked=false"), "jin": ("--mode", "jin"), "paper": ("--mode", "paper")}
LIGHTS = ("sky", "sun")
WAYS = ("reflected", "transmitted")
# Pixels and the texels of a repeat (256) that one of them is wide: near shows a repeat, from afar each pixel is one.
SCALES = {"near": {"pixels": 64, "repeats": 1 / 64}, "far": {"pixels": 16, "repeats": 1}}
# Yarns that nothing passes: what is left between plies and surface is visibility and light between yarns alone.
OPAQUE = {"thickness": 20, "diffuse": .4, "diffuse_transmission": 0, "albedo_transmission": 0}
AZIMUTH = 35          # of the view, from the weft [deg]
SUN = (.6, .35, math.sqrt(1 - .36 - .1225))   # along weft, along warp, out of the front: 44 degrees from it
PICTURE = 112         # side of one picture on the sheet [px]
DISTANCE = .5         # of the eye [m]: rays are parallel within 2 degrees, and float resolves a thousandth of a yarn

LONG = {"fabrics": tuple(FABRICS), "angles": (0, 45, 75), "samples": 1 << 17, "opaque": True, "picture_spp": 128}
SHORT = LONG | {"angles": (0, 60), "samples": 1 << 15, "picture_spp": 64}


def say(text):
    print(f"plies: {text}", file=sys.stderr)


def fabric_file(fabric):
    return bench_report.ROOT / "assets" / "fabrics" / f"{FABRICS[fabric]}.json"


def world(along_weft, along_warp, out):
    """From a plane's own axes: u is x, v is -z, the front is y."""
    return [along_weft, out, -along_warp]


def write_skies(folder):
    """White halves of a sky: over the front, and behind the back."""
    for way, rows in (("reflected", slice(0, 64)), ("transmitted", slice(64, 128))):
        half = np.zeros((128, 256, 3), "f4")
        half[rows] = 1
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": half}).write(str(folder / f"{way}.exr"))


def scene(fabric, tile, angle, light, way, scale, folder):
    """A swatch, seen from its front at `angle`, lit from its front (reflected) or its back (transmitted)."""
    theta, azimuth = math.radians(angle), math.radians(AZIMUTH)
    eye = world(DISTANCE * math.sin(theta) * math.cos(azimuth), DISTANCE * math.sin(theta) * math.sin(azimuth), DISTANCE * math.cos(theta))
    repeat = max(tile)
    shown = scale["pixels"] * scale["repeats"] * repeat
    # Beyond what is seen light has to find cloth as well; whole repeats, so that both geometries end at the same place.
    repeats = [2 * math.ceil((.5 * shown / math.cos(theta) + 10 * repeat) / own) for own in tile]
    size = [count * own for count, own in zip(repeats, tile)]
    sun = [value * (1 if way == "reflected" or axis < 2 else -1) for axis, value in enumerate(SUN)]
    lights = {"sky": {"type": "environment", "image": str(folder / f"{way}.exr"), "visible": True},
              "sun": {"type": "directional", "direction": [-value for value in world(*sun)], "irradiance": math.pi / SUN[2]}}
    return {"camera": {"position": eye, "target": [0, 0, 0], "up": world(0, 1, 0), "fov": math.degrees(2 * math.atan(.5 * shown / DISTANCE))},
            "film": {"resolution": [scale["pixels"]] * 2, "exposure": 0}, "lights": [lights[light]],
            "objects": [{"shape": "plane", "scale": [size[0], 1, size[1]], "fabric": str(fabric_file(fabric)), "uv_scale": size}]}


def overrides(fabric, opaque):
    if not opaque:
        return []
    yarns = ("yarn",) if json.loads(fabric_file(fabric).read_text()).get("knit") else ("warp", "weft")
    return [word for yarn in yarns for key, value in OPAQUE.items() for word in ("-D", f"objects.0.fabric.{yarn}.{key}={value}")]


def green(path):
    """Radiance of a picture and its variance."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return channels["G"].pixels.astype("f8"), channels["variance.G"].pixels.astype("f8")


def mean_of(path):
    """Mean radiance and its standard deviation."""
    values, variance = green(path)
    return float(values.mean()), float(variance.sum()) ** .5 / values.size


def render(path, out, samples, pixels, *words):
    return bench_report.run_program("selvedge-render", path, "-q", "-o", out, "--spp", max(samples // pixels ** 2, 8), *words)


def difference(own, truth):
    """What a mode makes of a cell, beside what the plies make of it. `rms` is over pixels, relative to the mean, less the noise of both."""
    (mean, sigma), (true, true_sigma) = mean_of(own), mean_of(truth)
    (own_values, own_variance), (true_values, true_variance) = green(own), green(truth)
    square = float(((own_values - true_values) ** 2 - own_variance - true_variance).mean())
    seen = bench_report.run_program("selvedge-compare", own, truth, "--fail", "max_abs=1e9", allowed=(0, 1))
    return {"mean": mean, "error": mean / true - 1, "error_95": 1.96 * math.hypot(sigma / true, mean * true_sigma / true ** 2),
            "rms": max(square, 0.0) ** .5 / true, "relmse": max(seen["relmse"] - seen["relmse_noise"], 0.0), "flip": seen["flip"]}


def picture(options, folder, out):
    """out/plies.png: above the plies, below ours, a fabric a column: an oblique close-up under sun and sky."""
    sheet = Image.new("RGB", (PICTURE * len(FABRICS), 2 * PICTURE))
    for column, fabric in enumerate(FABRICS):
        say(f"picture of {fabric}")
        tile = bench_report.run_program("selvedge-bake", fabric_file(fabric))["tile"]
        path = folder / "scene.json"
        close = scene(fabric, tile, 40, "sky", "reflected", {"pixels": PICTURE, "repeats": 1.5 / PICTURE}, folder)
        sun = scene(fabric, tile, 40, "sun", "reflected", SCALES["near"], folder)["lights"][0] | {"irradiance": 2.0}
        close["lights"] = [{"type": "environment", "colour": .25}, sun]
        path.write_text(json.dumps(close))
        for row, words in enumerate((("--model", "plies"), ("--mode", "ours"))):
            shown = folder / "shown.png"
            bench_report.run_program("selvedge-render", path, "-q", "-o", shown, "--spp", options["picture_spp"], *words)
            sheet.paste(Image.open(shown).convert("RGB"), (PICTURE * column, PICTURE * row))
    out.mkdir(parents=True, exist_ok=True)
    sheet.save(out / "plies.png", optimize=True)


def measure(options, folder):
    """[{"fabric", "opaque", "angle", "light", "way", "scale", "plies": {"mean", "mean_95"}, "modes": {mode: difference}}]"""
    write_skies(folder)
    cells = []
    for fabric in options["fabrics"]:
        tile = bench_report.run_program("selvedge-bake", fabric_file(fabric))["tile"]
        kinds = [(False, way) for way in WAYS] + [(True, "reflected")] * options["opaque"]
        for opaque, way in kinds:
            say(f"{fabric}, {'opaque, ' if opaque else ''}{way}")
            for angle in options["angles"]:
                for light in LIGHTS:
                    for name, scale in SCALES.items():
                        path, truth, out = folder / "scene.json", folder / "plies.exr", folder / "out.exr"
                        path.write_text(json.dumps(scene(fabric, tile, angle, light, way, scale, folder)))
                        words = overrides(fabric, opaque)
                        render(path, truth, options["samples"], scale["pixels"], "--model", "plies", *words)
                        mean, sigma = mean_of(truth)
                        modes = {}
                        for mode in MODES if not opaque else ("ours",):
                            render(path, out, options["samples"], scale["pixels"], "--seed", 1, *MODES[mode], *words)
                            modes[mode] = difference(out, truth)
                        cells.append({"fabric": fabric, "opaque": opaque, "angle": angle, "light": light, "way": way, "scale": name,
                                      "plies": {"mean": mean, "mean_95": 1.96 * sigma}, "modes": modes})
    return cells


def figures_of(cells):
    figures = {}
    for way in WAYS:
        for scale in SCALES:
            for mode in MODES:
                here = [cell for cell in cells if cell["way"] == way and cell["scale"] == scale and not cell["opaque"]]
                errors = [cell["modes"][mode] for cell in here]
                worst = max(errors, key=lambda cell: abs(cell["error"]))
                figures[f"error.{way}.{scale}.{mode}"] = figure(
                    (sum(cell["error"] ** 2 for cell in errors) / len(errors)) ** .5, "", "lower", runs=len(errors),
                    note=f"RMS over fabrics, views and lights; worst {worst['error']:+.3f} ± {worst['error_95']:.3f} (95 %)")
    opaque = [cell["modes"]["ours"] for cell in cells if cell["opaque"]]
    if opaque:
        figures["error.opaque.ours"] = figure((sum(cell["error"] ** 2 for cell in opaque) / len(opaque)) ** .5, "", "lower", runs=len(opaque),
                                              note="yarns that nothing passes, reflected, near and far")
    for scale, key in (("near", "rms"), ("far", "relmse"), ("far", "flip")):
        for mode in MODES:
            here = [cell["modes"][mode][key] for cell in cells if cell["scale"] == scale and cell["way"] == "reflected" and not cell["opaque"]]
            figures[f"{key}.reflected.{scale}.{mode}"] = figure(sum(here) / len(here), "", "lower", runs=len(here), note="mean over pictures")
    return figures


def main():
    parser = argparse.ArgumentParser(description="How far each mode of the surface model is from the plies themselves.")
    parser.add_argument("--quick", action="store_true", help="fewer angles and samples: about six minutes")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    arguments = parser.parse_args()
    options = dict(SHORT if arguments.quick else LONG)
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as name:
        cells = measure(options, pathlib.Path(name))
        picture(options, pathlib.Path(name), arguments.out)
    bench_report.write("plies", figures_of(cells), {}, out=arguments.out, load=load, quick=arguments.quick,
                       tables={"cells": cells, "angles": options["angles"], "samples": options["samples"]})


if __name__ == "__main__":
    main()
