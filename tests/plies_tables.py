"""docs/plies.md out of out/bench/plies.json. tests/bench_report.py calls document(); nothing here measures."""
from ingredient_tables import table

INTRODUCTION = """\
# How far the surface model is from the plies themselves

Made by `python tests/bench_report.py` from `out/bench/plies.json`, which `./dev bench plies` leaves; not edited by hand.

`selvedge-render SCENE --model plies` leaves the maps aside and traces the tubes that the maps are projections of: every ply, instanced
repeat by repeat over a plane or a cylinder (other shapes are refused), with full scattering. This is the curve-based method that
the surface model is meant to match.

![Above the plies, below ours: plain, satin, twill, jersey](plies.png)

Above the plies, below the same view by our mode: plain, satin, twill and jersey under a sun and a sky.

## What is traced

- A tube is a mesh of 32 sides with smooth normals about the ply's centre line, in the section that the bake has, as large as the
  round one. Ray and tube meet exactly; nothing is projected, filtered or limited in slope.
- A yarn, the union of its plies, is one slab of [math.md](math.md) 3 with the optical thickness `T` of the fabric, whatever the length
  of the way through it. A ray that meets it enters at one point and would leave it, straight on, at another. Each has a normal, that of
  the ply there, and a tangent, the ply's way turned by the fibre twist and its noise; the shared functions of the point BSDF are
  called as they are, in the frame of that normal.
- Light is reflected where the ray enters. Half of what is transmitted bends there, too, and leaves the yarn where its new straight
  line does. The other half bends where the old straight line leaves. So a path and its reverse are the same, and the cloth is
  reciprocal. Light that meets no fibre goes straight on; its share is the mean of that at both ends.
- A chord of a round section makes the same angle with the normal at both ends, so no more than the slab's share leaves the yarn. In
  other sections this holds in the mean over chords, which come in mirrored pairs.
- Every yarn on the way counts, once each time a ray enters it. Yarns that the bake lets overlap are two yarns that touch.
- Paths go on to the thirty-second scattering (`--max-depth`). There is no horizon, footprint or estimate of interreflection.

`tests/cpp/plies_test.cpp` holds this to closed forms for a straight tube, to the path tracer of the height field where opaque tubes are
one, to reciprocity, and to the white furnace.

Where it is another model than the surface's, and not only a more exact one:

- Where two yarns lie over each other the surface model adds them up by their means over directions, but for what
  one of them bends and the other lets pass unscattered (`stacked`,
  [model.md](model.md)); *unstacked* takes the whole cloth at a texel for one slab (math.md 5.1). Here light crosses the yarn in front,
  then the one behind it, and goes to and fro between them, each time by the lobes.
- There, up and down of the cloth decide what is reflection and what transmission; here the ply's own normal does. On the flanks
  of a yarn light may so be reflected downwards, where the surface has a transmission lobe about the normal of the back.
- There, walls between yarns are ramps no steeper than the slopes that can be stored; here they are the undersides of tubes.
- There, transmission takes the fibre tangent of the side that is looked at or, of two yarns, of either; here that of the bend.
- `diffuse_mix` below 1 has no meaning here: there is no macroscopic normal. Open ends of tubes at the edge of a swatch can be looked into.

## How it was measured

A flat swatch is seen from its front, at several angles, along 35 degrees from the weft. It is lit from its front (*reflected*) or its
back (*transmitted*), by a white half of a sky or by a sun at 44 degrees; what is seen straight through gaps of a sky behind belongs to
*transmitted*. *Near*: 64 x 64 pixels show one repeat, a pixel is 4 texels wide. *Far*: 16 x 16 pixels, each a repeat. Plies are
rendered by paths, the surface by direct light, as the preview shows it. Numbers are of the green channel. *Error* is of the
mean over the picture, relative to the plies, with its 95 % confidence from the variance layers of both.
"""

ANALYSIS = """\
## What remains

With yarns that nothing passes (*opaque* below) the mean of ours is within {opaque:.1f} % of the plies (RMS over fabrics, views,
lights and scales). With the fabrics as they are it is {reflected:.1f} % off in reflection and {transmitted:.1f} % in transmission; without
`stacked`, {reflected_unstacked:.1f} % and {transmitted_unstacked:.1f} %. The rest is light that crosses yarns at a slant and on their flanks: at
grazing views too much is let through. Reflected and transmitted light together, under a sky on either side, are {sums}.
"""


def percent(cell):
    return f"{100 * cell['error']:+.1f} ± {100 * cell['error_95']:.1f}"


def rms_error(cells, mode):
    errors = [cell["modes"][mode]["error"] for cell in cells]
    return 100 * (sum(error ** 2 for error in errors) / len(errors)) ** .5


def select(cells, **keys):
    return [cell for cell in cells if all(cell[key] == value for key, value in keys.items())]


def error_table(cells):
    modes = list(cells[0]["modes"])
    rows = [[f"{cell['fabric']}, {cell['light']}, {cell['angle']}°", f"{cell['plies']['mean']:.4f} ± {cell['plies']['mean_95']:.4f}",
             *(percent(cell["modes"][mode]) for mode in modes)] for cell in cells]
    return table(["fabric, light, view", "plies", *(f"{mode}, %" for mode in modes)], rows)


def picture_table(cells):
    modes = list(cells[0]["modes"])
    rows = []
    for fabric in dict.fromkeys(cell["fabric"] for cell in cells):
        for way in ("reflected", "transmitted"):
            near, far = (select(cells, fabric=fabric, way=way, scale=scale) for scale in ("near", "far"))
            mean = lambda here, mode, key: sum(cell["modes"][mode][key] for cell in here) / len(here)
            rows.append([f"{fabric}, {way}", *(f"{100 * mean(near, mode, 'rms'):.0f}" for mode in modes),
                         *(f"{mean(far, mode, 'relmse'):.3f}" for mode in modes), *(f"{mean(far, mode, 'flip'):.3f}" for mode in modes)])
    head = [f"{what}, {mode}" for what in ("near RMS %", "far relMSE", "far FLIP") for mode in modes]
    return table(["fabric, side", *head], rows)


def sums(cells):
    """Reflected and transmitted light under a sky, by plies and by ours, mean over fabrics and views."""
    total = {"plies": 0.0, "ours": 0.0}
    both = [cell for cell in cells if cell["light"] == "sky" and cell["scale"] == "far"]
    for cell in both:
        total["plies"] += cell["plies"]["mean"]
        total["ours"] += cell["modes"]["ours"]["mean"]
    pairs = len(both) / 2
    return f"{total['plies'] / pairs:.3f} by the plies and {total['ours'] / pairs:.3f} by ours"


def document(report, busy=""):
    """docs/plies.md as text. `busy`: a warning in words where the machine had other work."""
    tables = report["tables"]
    cells, opaque = select(tables["cells"], opaque=False), select(tables["cells"], opaque=True)
    text = INTRODUCTION + f"\n{tables['samples']} samples a picture. {report['date'][:10]}, revision {report['git']}, {report['cpu']}"
    text += ", short form (`--quick`)" * bool(report.get("quick")) + busy + ".\n\n"
    text += ANALYSIS.format(opaque=rms_error(opaque, "ours"), reflected=rms_error(select(cells, way="reflected"), "ours"),
                            transmitted=rms_error(select(cells, way="transmitted"), "ours"), sums=sums(cells),
                            reflected_unstacked=rms_error(select(cells, way="reflected"), "unstacked"),
                            transmitted_unstacked=rms_error(select(cells, way="transmitted"), "unstacked"))
    for way in ("reflected", "transmitted"):
        for scale, words in (("near", "near"), ("far", "from afar")):
            text += f"\n## Error of the mean: {way}, {words}\n\n" + error_table(select(cells, way=way, scale=scale))
    text += "\n## Error of the mean: opaque yarns, reflected\n\n"
    text += "The same yarns with `T` 20, diffuse reflectance .4 and no transmission lobes.\n\n"
    text += "Near:\n\n" + error_table(select(opaque, scale="near")) + "\nFrom afar:\n\n" + error_table(select(opaque, scale="far"))
    text += "\n## Pictures\n\nMeans over views and lights, less the noise of both pictures but for FLIP.\n\n" + picture_table(cells)
    return text.replace("\n\n\n", "\n\n").rstrip("\n") + "\n"
