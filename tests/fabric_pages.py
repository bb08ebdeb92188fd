"""What ./dev fabrics does: docs/fabrics.md and its pictures, all from assets/fabrics and what the programs say and draw about
them. A fabric is a preset where its yarns state their tex; the others are the tests'."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import PIL.Image

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
FABRICS = ROOT / "assets" / "fabrics"
DOCS = ROOT / "docs"
PICTURE = 224     # pixels a side
SAMPLES = 128
THREADS, WALES = 30, 15   # that the near view shows
SHEET = 960       # pixels across
SUN = [4.4, 4.2, 3.9]
GREY, DARK = {"albedo": [0.35, 0.33, 0.31]}, {"albedo": [0.03, 0.03, 0.03]}

HEAD = """# Fabrics

Presets in `assets/fabrics`, with their yarns as the textile trade states them. `./dev fabrics` writes this page and its
pictures: the programs measured and drew what stands here.

"""
FOOT = """
R and T: light that a cloth sends back and lets through under a uniform sky, seen from the front at 0 and 60 degrees;
luminance, of the whole model (`selvedge-bake --albedo`). Cover: share of the area that is not open. Width: across a yarn in the
cloth, from its tex.

# Where the numbers come from

| value | from |
| --- | --- |
| threads, tex, weight | the construction that each fabric names below |
| width | `tex` and `fibre`: fibre density (Morton & Hearle, "Physical Properties of Textile Fibres") over the packing of the yarn (cotton: Peirce's 1.1 cm3/g, 1937), over the area that a section of this `aspect` has, and for plied yarns over the share of it that plies fill. `width_of_tex` in `bake/fabric.cpp`, the table in `bake/params.hpp` |
| aspect | how far yarns are pressed flat: untwisted filament 0.25 to 0.45, spun yarns 0.45 to 0.7, hard twisted silk 0.75 to 0.8, loops 0.8 to 0.9; more where threads are packed so closely that they hold each other upright (warp of charmeuse, drill and denim: 0.57, 0.76, 0.95) |
| section | `racetrack` (Kemp 1958) for flat filament, ellipses for all else |
| roughness | near Zhu et al. 2023, table 1 (satin 0.04 to 0.05, twill 0.20 to 0.25, jersey 0.3): filament 0.06 to 0.10, crepe 0.18, cotton 0.20 to 0.35; linen between silk and cotton, wool above, for its scales and crimp |
| fibre twist | filament 2 to 6 degrees, organza 12, spun yarns 16 to 24, crepe 38 |
| optical thickness, albedo | chosen by eye, so that R and T are those of such cloth: a white shirt lets about a third of the light through, denim hardly any, organza most |

Pictures: 1.4 m of the cloth over a ball in sky and sun; 30 ends or 15 wales of it on a rod, the warp along the rod. Sheets:
`selvedge-bake --preview`, the front above, the back below; colour, normal, direction of the ply, height, sky that it sees,
horizons.
"""


def presets():
    """[(name, fabric as written)]"""
    every = {path.stem: json.loads(path.read_text()) for path in sorted(FABRICS.glob("*.json")) if ".schema" not in path.name}
    return [(name, fabric) for name, fabric in every.items() if any("tex" in fabric.get(yarn, {}) for yarn in ("warp", "weft", "yarn"))]


def drape(fabric, _):
    """A cloth of 1.4 m over a ball on a plinth, in sky and sun."""
    return {
        "camera": {"position": [-0.75, 1.02, 2.05], "target": [0, 0.55, 0], "up": [0, 1, 0], "fov": 25},
        "film": {"resolution": [PICTURE, PICTURE], "filter": "tent", "exposure": 0.1},
        "lights": [{"type": "environment", "image": str(ROOT / "assets/lights/sky.exr"), "visible": True},
                   {"type": "directional", "direction": [0.62, -0.58, -0.53], "irradiance": SUN, "angular_diameter": 0.53}],
        "objects": [{"shape": "plane", "scale": [60, 1, 60], "matte": GREY},
                    {"shape": "cylinder", "scale": [0.13, 0.64, 0.13], "translate": [0, 0.30, 0], "matte": GREY},
                    {"shape": "sphere", "scale": 0.21, "translate": [0, 0.80, 0], "matte": GREY},
                    {"shape": "drape", "fabric": fabric, "uv_scale": 1.4}]}


def near(fabric, width):
    """So many metres of the cloth on a rod, the warp along it, lit from the left; dark behind."""
    radius, height = 0.62 * width, 3 * width
    return {
        "camera": {"position": [0, 0, radius + 12 * width], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 4.77},
        "film": {"resolution": [PICTURE, PICTURE], "filter": "tent", "exposure": 0.2},
        "lights": [{"type": "environment", "colour": [0.35, 0.37, 0.40], "visible": False},
                   {"type": "directional", "direction": [0.55, -0.25, -0.75], "irradiance": [4.2, 4.1, 4.0], "angular_diameter": 2}],
        "objects": [{"shape": "cylinder", "scale": [radius, height, radius], "fabric": fabric, "uv_scale": [2 * 3.14159265 * radius, height]},
                    {"shape": "cylinder", "scale": [0.98 * radius, height, 0.98 * radius], "matte": DARK}]}


def near_width(report):
    lengths = report["lengths"]
    return WALES * lengths["wale_spacing"] if "wale_spacing" in lengths else THREADS * lengths["warp"]["spacing"]


def run(program, *arguments):
    done = subprocess.run([BIN / program, *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        sys.exit(1)   # the program has said why
    return done.stdout


def draw(name, folder):
    """docs/fabrics/NAME.jpg: drape and near view; docs/fabrics/NAME_maps.jpg: the sheet of --preview. Returns the bake's report."""
    fabric = FABRICS / f"{name}.json"
    report = json.loads(run("selvedge-bake", fabric, "--preview", folder / f"{name}.png", "--albedo", "--json"))
    if report["warnings"]:
        sys.exit(f"{fabric}: {report['warnings'][0]}")
    both = PIL.Image.new("RGB", (2 * PICTURE + 4, PICTURE), "white")
    for k, scene in enumerate((drape, near)):
        path = folder / f"{name}_{scene.__name__}.json"
        path.write_text(json.dumps(scene(str(fabric), near_width(report))))
        run("selvedge-render", path, "-o", path.with_suffix(".png"), "--spp", SAMPLES, "--integrator", "path", "-q")
        both.paste(PIL.Image.open(path.with_suffix(".png")).convert("RGB"), (k * (PICTURE + 4), 0))
    both.save(DOCS / "fabrics" / f"{name}.jpg", quality=90)
    sheet = PIL.Image.open(folder / f"{name}.png").convert("RGB")
    size = SHEET, round(sheet.height * SHEET / sheet.width)
    sheet.resize(size, PIL.Image.Resampling.BOX).save(DOCS / "fabrics" / f"{name}_maps.jpg", quality=82)
    return report


def row(name, fabric, report):
    """A line of the table."""
    lengths, yarns = report["lengths"], [fabric[key] for key in ("warp", "weft", "yarn") if key in fabric]
    if "yarn" in lengths:
        what, threads = fabric["knit"], [0.01 / lengths["wale_spacing"], 0.01 / lengths["course_spacing"]]
        widths = [lengths["yarn"]["width"]]
    else:
        what, threads = fabric["pattern"], [0.01 / lengths[key]["spacing"] for key in ("warp", "weft")]
        widths = [lengths[key]["width"] for key in ("warp", "weft")]
    if isinstance(what, dict):
        what = pathlib.Path(next(iter(what.values()))).name
    tex = [f"{'R ' if yarn['plies'] > 1 else ''}{yarn['tex']:g}{'/%d' % yarn['plies'] if yarn['plies'] > 1 else ''}" for yarn in yarns]
    pair = lambda values: " x ".join(dict.fromkeys(values))   # once where both are the same
    luminance = lambda rgb: 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
    seen = {entry["angle"]: entry for entry in report["albedo"] if entry["side"] == "front"}
    return [f"[{fabric['name']}](#{name})", what, pair(f"{t:.3g}" for t in threads), pair(tex), pair(yarn["fibre"] for yarn in yarns),
            pair(f"{1e3 * w:.3f}" for w in widths), f"{100 * (1 - report['coverage']['gap']):.0f} %",
            *(f"{luminance(seen[angle][key]):.3f}" for key in ("reflectance", "transmittance") for angle in (0, 60))]


if __name__ == "__main__":
    columns = ["fabric", "pattern", "threads or wales x courses per cm", "tex", "fibre", "width [mm]", "cover", "R 0", "R 60", "T 0", "T 60"]
    lines, pages = [columns, ["---"] * len(columns)], []
    (DOCS / "fabrics").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, fabric in presets():
            print(f"fabrics: {name}", file=sys.stderr, flush=True)
            report = draw(name, pathlib.Path(folder))
            lines.append(row(name, fabric, report))
            pages.append(f"\n## <a name=\"{name}\"></a>{fabric['name']}\n\n{fabric['comment']}\n\n"
                         f"![{fabric['name']}: draped, and {1e3 * near_width(report):.2g} mm of it](fabrics/{name}.jpg)\n\n![maps](fabrics/{name}_maps.jpg)\n")
    table = "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
    (DOCS / "fabrics.md").write_text(HEAD + table + FOOT + "".join(pages))
