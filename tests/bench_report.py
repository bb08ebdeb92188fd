"""What all benchmark suites share: the JSON report, its plots, its table, and docs/benchmarks.md made from the reports.

As a program: `bench_report.py` reads out/bench/*.json and writes docs/benchmarks.md and the plots it shows; what has no report stays as it is."""
import argparse
import datetime
import json
import math
import os
import pathlib
import subprocess
import sys
import time

import ingredient_tables
import plies_tables

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
SCHEMA = 1
DOCUMENT = ROOT / "docs" / "benchmarks.md"


def figure(value, unit, better, *, target=None, runs=1, note=""):
    """One number of a report. `better`: "lower" or "higher"; value None: could not be measured, and `note` says why."""
    assert better in ("lower", "higher") and (value is None or math.isfinite(value)) and (value is not None or note)
    return {"value": value, "unit": unit, "better": better, "target": target, "runs": runs, "note": note}


def met(entry):
    """Whether a figure meets its target; None where it has none or no value."""
    if entry["target"] is None or entry["value"] is None:
        return None
    return entry["value"] <= entry["target"] if entry["better"] == "lower" else entry["value"] >= entry["target"]


def cpu():
    """The processor by its own name and the number of cores that this process may use."""
    name = next((line.split(":", 1)[1].strip() for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines()
                 if line.startswith("model name")), "unknown processor")
    return f"{name}, {len(os.sched_getaffinity(0))} cores"


def other_load():
    """How many threads of other programs want a processor, on average over one second; 0 on an idle machine."""
    counts = []
    for _ in range(20):
        counts.append(int(pathlib.Path("/proc/loadavg").read_text().split()[3].split("/")[0]) - 1)
        time.sleep(.05)
    return sum(counts) / len(counts)


def git():
    done = subprocess.run(["git", "-C", ROOT, "describe", "--always", "--dirty"], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else "unknown"


def run_program(program, *arguments, allowed=(0,), timeout=1800):
    """The JSON object that a selvedge program prints. Its messages go to the terminal; a failure ends the suite."""
    command = [BIN / program, *map(str, arguments), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=timeout)
    if done.returncode not in allowed:
        sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}")
    return json.loads(done.stdout)


def write(suite, figures, curves, *, out, load, gl="", axes=("", ""), own_axes=None, groups=None, **more):
    """Writes OUT/SUITE.json whole or not at all, one SVG for each curve and one for each group, and prints the table.

    curves  {name: [[x, y, low, high], ...]}; axes: their labels, both logarithmic; own_axes: {plot name: labels} of those that have others
    load    other_load() before the suite's first measurement
    groups  {plot name: [curve name, ...]}: curves that belong on one sheet
    more    further fields of the report"""
    report = {"schema": SCHEMA, "suite": suite, "git": git(), "cpu": cpu(), "gl": gl,
              "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"), "figures": figures, "curves": curves}
    report |= {"groups": groups or {}, "axes": list(axes), "other_load": load} | more
    out = pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    for name, members in ({name: [name] for name in curves} | (groups or {})).items():
        draw(out / f"{suite}-{name}.svg", {member: curves[member] for member in members}, (own_axes or {}).get(name, axes), name)
    beside = out / f"{suite}.json.tmp"
    beside.write_text(json.dumps(report, indent=1) + "\n")
    beside.replace(out / f"{suite}.json")
    print_table(report)
    return report


INK, GRID = "#333333", "#dddddd"
COLOURS = ("#b4431f", "#1f6fb4", "#3d8b37", "#8a5a9e", "#8c7a1f", "#5a5a5a")   # apart for colour-blind eyes, too, in their lightness


def draw(path, curves, axes, title):
    """Log-log SVG of curves [[x, y, low, high], ...] with their bands. Same numbers, same bytes."""
    import matplotlib
    matplotlib.use("svg")
    from matplotlib import pyplot
    settings = {"svg.hashsalt": "selvedge", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 10, "axes.edgecolor": INK,
                "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK, "text.color": INK, "axes.spines.top": False,
                "axes.spines.right": False}
    with matplotlib.rc_context(settings):
        sheet, axis = pyplot.subplots(figsize=(6.4, 4.2), layout="constrained")
        common = os.path.commonprefix(list(curves)) if len(curves) > 1 else ""
        common = common[:common.rfind(".") + 1]   # the sheet's title says it
        for (name, points), colour, marker in zip(curves.items(), COLOURS * 8, "osD^v<>P" * 6):
            points = [point for point in points if point[0] > 0 and point[1] > 0]
            if not points:
                continue
            x, y, low, high = zip(*points)
            floor = min(y) / 10   # a band that reaches 0 has no place on a logarithmic axis
            axis.fill_between(x, [max(value, floor) for value in low], high, color=colour, alpha=.18, linewidth=0)
            axis.plot(x, y, color=colour, marker=marker, markersize=4, linewidth=1.6, label=name.removeprefix(common))
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(axes[0])
        axis.set_ylabel(axes[1])
        axis.set_title(title, loc="left", fontsize=11)
        axis.grid(True, which="major", color=GRID, linewidth=.8)
        axis.grid(True, which="minor", color=GRID, linewidth=.3)
        axis.set_axisbelow(True)
        if axis.has_data():
            axis.legend(frameon=False)
        beside = path.with_suffix(".tmp")
        sheet.savefig(beside, format="svg", metadata={"Date": None})
        pyplot.close(sheet)
    beside.replace(path)


def busy(report):
    """A warning in words where the machine had other work to do."""
    return f"; the machine was busy with {report['other_load']:.1f} other threads, times are too long" if report["other_load"] >= .5 else ""


def shown(value):
    if value is None:
        return "-"
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e9 else f"{value:.4g}"


def rows(report):
    """(name, value with unit, target, verdict, note) of each figure."""
    for name, entry in report["figures"].items():
        verdict = {None: "", True: "met", False: "MISSED"}[met(entry)]
        target = "" if entry["target"] is None else f"{'≤' if entry['better'] == 'lower' else '≥'} {shown(entry['target'])}"
        yield name, f"{shown(entry['value'])} {entry['unit'] if entry['value'] is not None else ''}".strip(), target, verdict, entry["note"]


def print_table(report):
    table = [("figure", "value", "target", "", "note"), *rows(report)]
    widths = [max(len(row[column]) for row in table) for column in range(4)]
    print(f"{report['suite']}: {report['cpu']}" + (f"; {report['gl']}" if report["gl"] else "") + busy(report))
    for row in table:
        print("  " + "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths)), row[4]]).rstrip())


INTRODUCTION = """\
# Benchmarks

Made by `python tests/bench_report.py` from the reports that `./dev bench` leaves in `out/bench`; not edited by hand.
Every ratio compares two things measured in the same run. *Runs* is the number of repetitions behind a figure, whose median it is.
"""

METHODS = {
    "error-time": """\
Seconds that each renderer takes to a given error, `direct` lighting, on the same scene at the same resolution. Each point is a
render of its own from the first sample on, with a seed of its own (`--spp` in both: the preview draws frames of up to 32 samples); the seconds are the program's `seconds.render`, which leaves out
loading, baking, building the BVH and compiling shaders. The error is relMSE, mean of (a-b)²/(b²+0.01), against a long render by the
reference with another seed, less the part that this long render's own variance layer accounts for; so the figure is that against the
noiseless image. `speedup` compares pictures as they come; `denoised` is the preview's as the window shows it, through the filter of
`--denoise`, whose seconds count, against the reference without it. Passes over all sample counts are repeated, preview and reference in turn; line: median, band: lowest and highest.
Seconds to an error are interpolated between neighbouring points in the logarithms of both; *extrapolated* says that the series' time
ran out above the error, and that the last points' slope and cost per sample were carried on, 32-fold at most.""",
    "bake": """\
What a bake costs and what visibility gains, on the plain weave of two-ply yarns; each bake is a process of its own that finds nothing in
the cache. Stages are the program's own `seconds`, both sides together: *maps* projects the plies, *visibility* sweeps horizons and
integrates the sky over them, *normals* packs texels and slope mips; *total* holds the yarns' tables as well. The sweep is set against brute
force, one march for each block and azimuth, in the same run; of many blocks every so many rows are marched, and the seconds scaled.
Accuracy is the RMS of V against exact rays over texels, both sides, and directions uniform in solid angle; `none` is V = 1.""",
    "reference": """\
`samples_over_raw_embree`: time of the same rays one by one in bare Embree, a camera ray a sample and as many shadow rays as the integrator
traced, over the time of the integrator's sample (`direct`), on one thread, in one process, in turn; the bare tree is of
high quality and without filters. `demo_sky` and `demo_sun` are the demo scene with one of its lights; with both, as *demo*, a camera ray asks
both. `meso_over_micro` and `speedup_2_threads` are ratios of rendering seconds of runs in turn.
`bytes_per_triangle` is resident memory of mesh and tree. `adaptive_efficiency` compares sampling by `--target-error` with uniform sampling.

`efficiency_over_mitsuba`: 1/(relMSE × seconds) of the reference over that of Mitsuba 3 (`llvm_ad_rgb`, `path`), on scenes that both render: same
meshes, resolution and depth, two threads each, seconds of rendering alone. The figure is over Mitsuba with the sampler that suits it best here,
`multijitter`; the note adds the ratio over its default, `independent`. relMSE is against a long render by the reference, less that render's own
noise. `cloth_drape` is the ply-level model (`--bsdf micro`), in Mitsuba a Python plugin of the tests. That both renderers have the same expected
pictures is tested in `tests/test_mitsuba.py`.""",
    "ingredients": """\
What each ingredient of the model gains and costs; the tables and how they were measured are in [ingredients.md](ingredients.md). Here are the
worst fabrics' figures: accuracy of visibility against exact rays; error of the effective reflectance of close-ups at 75 degrees
against path tracing of the relief, all bounces for our mode, the first for the paper's; and time a sample over that of `micro`.""",
    "preview": """\
What the preview costs and saves, with software OpenGL unless the line above names a card. A frame is one sample of every pixel.
*specialised_over_general*: time of the program that the scene needs over that of the one that can do everything (`--keep all`), which draws
the same bits. *gain*: time with a part done in vain over time without it. *off_over_stripped*: a scene that needs nothing against a shader
written by hand for it (`tests/bench/stripped_shade.frag`). *max_bias*, *max_z_outliers*: against the reference, worst channel and scene.""",
    "gpu": """\
The preview on a graphics card, which the line above names; what the figures mean is said under *preview* and *error-time*. Frames are of one
sample a pixel. The reference beside it has all cores of that machine.""",
    "plies": """\
How far the surface model is from path tracing of the plies themselves; the tables and what they mean are in [plies.md](plies.md).""",
    "stability": """\
Every shared function on inputs that hunt trouble; errors by function, and what the figures mean, are in [stability.md](stability.md).""",
}

STABILITY = """\
# Stability

Made by `python tests/bench_report.py` from the report that `./dev bench stability` leaves in `out/bench`; not edited by hand.

Every shared function, and chains of them with every setting of the model, on random inputs that hunt trouble: alpha at its floor, grazing
to 1e-7, light along and against the view, fibres along normals, triangles and UVs without area, slopes at their clamp, footprints from 0
to 1e6 texels, intensities 1e-8 to 1e8, lights at distance 0 (`tests/cpp/stability_inputs.cpp`). No result may be NaN, infinite, negative
where that means nothing, above 1 for a share, or not of unit length for a direction.

*Errors* are those of float against double on the same inputs, each of them a float, relative to the value or the length of the vector (to 1
for coordinates and directions). Quantiles come from a histogram and are up to 4.5 % too high. An input is *flipped* if float and double
decided differently anywhere on the way: took another branch, or read another texel. Decisions are noted by a third and fourth build of the
same source, whose numbers record each comparison and each conversion to an integer. Flipped inputs are held to the same rule of good
numbers, but their errors tell nothing and are left out. A shader's decisions cannot be seen: there, inputs count as flipped where results
differ that are choices, where C++ float decides otherwise, or where double does after moving the input by 2^-17, which is many more.
What remains is rounding and what the input makes of it: differences of nearly equal positions, cosines near 0, half vectors of nearly
opposite directions, a rectangle of 1e-6 m at 1e3 m from the origin. *Unexplained* is the share of inputs whose error exceeds 2e-5 and 10
times what inputs 4 units in the last place away make of the exact result; there the rounding of a step in between is what is magnified:
corners and lights far from the origin, noise cells smaller than a texel, triangles without area, and, in shaders, the driver's own `atan`,
next to environment texels that differ by 1e16. `selvedge-stability --replay FUNCTION INDEX` shows the worst input of a row.
"""

BUILDS = {"cpp": "C++ float against double", "egl": "GLSL through EGL against C++ double", "osmesa": "GLSL through OSMesa against C++ double"}


def stability_document(report):
    """docs/stability.md as text: the errors of each function, one table for each build."""
    text = STABILITY + f"\n{report['date'][:10]}, revision {report['git']}, {report['cpu']}" + (f", {report['gl']}" if report["gl"] else "")
    text += ", short form (`--quick`)" * bool(report.get("quick")) + ".\n"
    for build, functions in report["functions"].items():
        total = {key: sum(entry[key] for entry in functions.values()) for key in ("inputs", "not_finite", "out_of_range")}
        text += f"\n## {BUILDS[build]}\n\n{total['inputs']:,} inputs in {report['seconds'][build]:.0f} s; results that are NaN or infinite: "
        text += f"{total['not_finite']}; outside their range: {total['out_of_range']}.\n\n"
        text += "| function | 50 % | 99.9 % | 99.9999 % | max | of input | flipped | unexplained |\n| --- " + "| ---: " * 7 + "|\n"
        for name, entry in functions.items():
            share = {key: f"{entry[key] / entry['inputs']:.1g}" if entry[key] else "0" for key in ("flipped", "unexplained")}
            errors = (f"{entry[key]:.1e}" if entry[key] else "0" for key in ("q50", "q99_9", "q99_9999", "max"))
            text += f"| `{name}` | {' | '.join(errors)} | {entry['worst_index']} | {share['flipped']} | {share['unexplained']} |\n"
    return text


def section(report):
    """A report's part of docs/benchmarks.md, its heading aside."""
    suite = report["suite"]
    text = METHODS[suite] + "\n\n" if suite in METHODS else ""
    text += f"{report['date'][:10]}, revision {report['git']}, {report['cpu']}" + (f", {report['gl']}" if report["gl"] else "")
    text += ", short form (`--quick`)" * bool(report.get("quick"))
    text += busy(report) + ".\n\n"
    text += "| figure | value | target | | runs | note |\n| --- | ---: | ---: | --- | ---: | --- |\n"
    for (name, value, target, verdict, note), entry in zip(rows(report), report["figures"].values()):
        text += f"| `{name}` | {value} | {target} | {verdict} | {entry['runs']} | {note.replace('|', '/')} |\n"
    names = report.get("groups") or report["curves"]
    return text + "".join(f"\n![{suite}, {name}](bench/{suite}-{name}.svg)\n" for name in names)


def document(reports, before=""):
    """docs/benchmarks.md as text. Sections that it had `before` stay where there is no report: not every machine can make each of them."""
    sections = dict(part.split("\n\n", 1) for part in before.split("\n## ")[1:])
    sections |= {report["suite"]: section(report) for report in reports}
    return INTRODUCTION + "".join(f"\n## {suite}\n\n{sections[suite].rstrip()}\n" for suite in sorted(sections))


def main():
    parser = argparse.ArgumentParser(description="docs/benchmarks.md from the reports of ./dev bench")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out" / "bench", help="folder of the reports")
    parser.add_argument("--document", type=pathlib.Path, default=DOCUMENT)
    options = parser.parse_args()
    reports = [json.loads(path.read_text()) for path in sorted(options.out.glob("*.json"))]
    if not reports:
        sys.exit(f"bench_report: no reports in {options.out}; run ./dev bench")
    plots = options.document.parent / "bench"
    plots.mkdir(parents=True, exist_ok=True)
    for report in reports:
        for name in report.get("groups") or report["curves"]:
            plot = f"{report['suite']}-{name}.svg"
            (plots / plot).write_bytes((options.out / plot).read_bytes())
    options.document.write_text(document(reports, options.document.read_text() if options.document.is_file() else ""))
    for report in reports:
        if report["suite"] == "ingredients":
            (options.document.parent / "ingredients.md").write_text(ingredient_tables.document(report, busy(report)))
        if report["suite"] == "plies":
            (options.document.parent / "plies.md").write_text(plies_tables.document(report, busy(report)))
            (options.document.parent / "plies.png").write_bytes((options.out / "plies.png").read_bytes())
        if report["suite"] == "stability":
            (options.document.parent / "stability.md").write_text(stability_document(report))
    print(f"{options.document}: {', '.join(report['suite'] for report in reports)}")


if __name__ == "__main__":
    main()
