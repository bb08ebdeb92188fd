"""docs/ingredients.md out of out/bench/ingredients.json. tests/bench_report.py calls document(); nothing here measures."""

INTRODUCTION = """\
# What each ingredient of the model gains and costs

Made by `python tests/bench_report.py` from `out/bench/ingredients.json`, which `./dev bench ingredients` leaves; not edited by hand.
The ingredients are those of [model.md](model.md); a row is a set of values of the scene's `model` object. The first rows are a ladder
from the paper's mode to ours, one ingredient a step. Below it each ingredient is switched by itself: first from the paper's mode, then
from ours.
"""

VISIBILITY = """\
## Visibility inside the fabric

V of a texel in a direction, against a ray in float64 that starts at the texel's centre and is held against every bilinear patch of the
full-resolution height field that it crosses. V is the mean over the sixteen spots of the texel, which many samples come to: from a
spot a ray looks up one half-resolution texel. Texels uniform over the repeat, directions uniform in solid angle over the hemisphere,
front and back. Bytes are those the representation needs for each texel and side (the ASG of the paper has five floats, a fitted
amplitude makes six; in memory both take 32). Nanoseconds are of one look-up at a random texel in C++ on one thread, the fastest of
nine passes; *none* shows what the loop itself costs.
"""

REFLECTANCE = """\
## Effective reflectance against relief ground truth

The truth is a path tracer of the same height field in float64 (`tests/cpp/relief_truth.hpp`): exact intersections with bilinear
patches, the patches' own normals, exact shadow rays, no horizon, march or sampling in common with the model. Its material is the
model's point BSDF in reflection, with the irregular twist. Light comes from a uniform sky over the front, or from one directional
light at 44 degrees. Footprints are squares of 1 to 256 texels (256 is the repeat), anywhere on the cloth, seen from any azimuth; truth
and model look at the same ones. *Error* is the mean over footprints, relative to the truth, with its 95 % confidence. *RMS* is over footprints; it comes
from two independent halves of the samples, so that noise adds nothing to its mean. A row without interreflection is held to the
light of the first bounce, a row with it (marked *all*) to that of all bounces: the fibres' light through thin yarns is no part of either.
"""

COST = """\
## Cost

Nanoseconds a sample on `{scene}`: the reference on one thread, the preview on {gl}. All rows but that of the
whole model are drawn in one process in turn, one sample of every pixel each; the ratio to `micro` is the median over the turns, with its
95 % interval. The whole model and `micro` have five processes of their own, since what the others leave of the caches, and where a process
puts its code and data, moves the ratio by a few percent: median, lowest and highest of them.
"""

SCENES = """
The model as a whole, ours over micro, by scene: the more a scene asks of light and shadow, the less the model counts.

"""


def percent(cell, width=1):
    return f"{100 * cell['error']:+.{width}f} ± {100 * cell['error_95']:.{width}f}"


def mean_cell(tables, model, light, angle, footprint):
    """Mean over the fabrics of one cell; fabrics are independent measurements."""
    rows = [cell["models"][model][light] for report in tables["reflectance"].values() for cell in report["cells"]
            if cell["angle"] == angle and cell["footprint"] == footprint]
    count = len(rows)
    root = lambda key: sum(row[key] ** 2 for row in rows) ** .5 / count
    return {"error": sum(row["error"] for row in rows) / count, "error_95": root("error_95"),
            "rms": (sum(row["rms"] ** 2 for row in rows) / count) ** .5, "rms_95": root("rms_95")}


def table(head, rows):
    return "| " + " | ".join(head) + " |\n| --- |" + " ---: |" * (len(head) - 1) + "\n" + "".join("| " + " | ".join(row) + " |\n" for row in rows) + "\n"


def models_of(tables):
    return [model for group in ("ladder", "paper", "ours", "base") for model in tables["groups"][group]]


def row_name(tables, model):
    return f"{model}{' *(all)*' if tables['bounces'][model] == 'all' else ''}"


def visibility_table(tables):
    kinds = list(next(iter(tables["visibility"].values())))
    fabrics = list(tables["visibility"])
    rows = []
    for kind in kinds:
        own = [tables["visibility"][fabric][kind] for fabric in fabrics]
        rows.append([kind, *(f"{row['rms']:.3f} ± {row['rms_95']:.3f}" for row in own), *(f"{row['bias']:+.3f}" for row in own[:1]),
                     f"{own[0]['bytes_per_texel']:.0f}", f"{sorted(row['nanoseconds'] for row in own)[len(own) // 2]:.1f}"])
    asked = next(iter(next(iter(tables["visibility"].values())).values()))["directions"]
    return (table(["kind", *(f"RMS, {fabric}" for fabric in fabrics), f"bias, {fabrics[0]}", "bytes", "ns"], rows) +
            f"{asked} texels and directions a fabric.\n\n")


def reflectance_tables(tables):
    angles, footprints = tables["angles"], tables["footprints"]
    report = next(iter(tables["reflectance"].values()))
    samples = report["places"] * report["samples_per_place"]
    text = (f"{len(tables['reflectance'])} fabric(s): {', '.join(tables['reflectance'])}; the tables show means over them, the JSON each. "
            f"{report['places']} footprints a cell, {report['samples_per_place']} samples each by model and by truth: {samples} a cell and fabric.\n\n")
    for light, words in (("sky", "uniform sky"), ("sun", "one directional light")):
        for footprint, place in ((footprints[0], "close-up"), (footprints[-1], "from afar")):
            text += f"### Error in percent by view angle: {words}, {place} (footprint {footprint} px)\n\n"
            text += table(["model", *(f"{angle}°" for angle in angles)],
                          [[row_name(tables, model), *(percent(mean_cell(tables, model, light, angle, footprint)) for angle in angles)]
                           for model in models_of(tables)])
    steep = 75 if 75 in angles else angles[-1]
    for light, words in (("sky", "uniform sky"), ("sun", "one directional light")):
        for what in ("error", "rms"):
            text += f"### {'Error' if what == 'error' else 'RMS over footprints'} in percent by footprint at {steep}°: {words}\n\n"
            cell = lambda model, footprint: mean_cell(tables, model, light, steep, footprint)
            shown = percent if what == "error" else lambda c: f"{100 * c['rms']:.1f} ± {100 * c['rms_95']:.1f}"
            text += table(["model", *(f"{footprint} px" for footprint in footprints)],
                          [[row_name(tables, model), *(shown(cell(model, footprint)) for footprint in footprints)] for model in models_of(tables)])
    text += "### The truth itself\n\nReflectance under the uniform sky; share of rays that look through a gap.\n\n"
    rows = []
    for fabric, own in tables["reflectance"].items():
        for cell in own["cells"]:
            if cell["footprint"] == footprints[-1]:
                truth = cell["truth"]
                rows.append([fabric, f"{cell['angle']:.0f}°", f"{truth['sky_once']:.4f}", f"{truth['sky_all']:.4f}", f"{truth['passes']:.4f}"])
    return text + table(["fabric", "view", "first bounce", "all bounces", "gaps"], rows)


def cost_table(tables):
    rows = []
    for model in models_of(tables):
        cells = [tables["cost"][renderer][tables["scenes"][0]].get(model) for renderer in ("reference", "preview")]
        if any(cells):
            rows.append([model, *(word for cell in cells for word in
                                  (f"{cell['nanoseconds']:.0f}", f"{cell['over_first']:.2f} ({cell['low']:.2f} to {cell['high']:.2f})"))])
    return table(["model", "reference, ns", "over micro", "preview, ns", "over micro"], rows)


def scenes_table(tables):
    rows = []
    for scene in tables["scenes"]:
        cells = [tables["cost"][renderer][scene][tables["ours"]] for renderer in ("reference", "preview")]
        rows.append([scene, *(f"{cell['over_first']:.2f} ({cell['low']:.2f} to {cell['high']:.2f})" for cell in cells)])
    return table(["scene", "reference", "preview"], rows)


def document(report, busy=""):
    """docs/ingredients.md as text. `busy`: a warning in words where the machine had other work."""
    tables = report["tables"]
    text = INTRODUCTION + f"\n{report['date'][:10]}, revision {report['git']}, {report['cpu']}"
    text += ", short form (`--quick`)" * bool(report.get("quick")) + busy + ".\n"
    text += "\n" + VISIBILITY + "\n" + visibility_table(tables)
    text += REFLECTANCE + "\n" + reflectance_tables(tables)
    text += COST.format(scene=tables["scenes"][0], gl=report["gl"]) + "\n" + cost_table(tables)
    text += SCENES + "\n" + scenes_table(tables)
    return text.rstrip("\n") + "\n"
