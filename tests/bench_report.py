"""What all benchmark suites share: the JSON report, its plots, its table, and docs/benchmarks.md made from the reports.

As a program: `bench_report.py` reads out/bench/*.json and writes docs/benchmarks.md and the plots it shows."""
import argparse
import datetime
import json
import math
import os
import pathlib
import subprocess
import sys
import time

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


def write(suite, figures, curves, *, out, load, gl="", axes=("", ""), groups=None, **more):
    """Writes OUT/SUITE.json whole or not at all, one SVG for each curve and one for each group, and prints the table.

    curves  {name: [[x, y, low, high], ...]}; axes: their labels, both logarithmic
    load    other_load() before the suite's first measurement
    groups  {plot name: [curve name, ...]}: curves that belong on one sheet
    more    further fields of the report"""
    report = {"schema": SCHEMA, "suite": suite, "git": git(), "cpu": cpu(), "gl": gl,
              "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"), "figures": figures, "curves": curves}
    report |= {"groups": groups or {}, "axes": list(axes), "other_load": load} | more
    out = pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    for name, members in ({name: [name] for name in curves} | (groups or {})).items():
        draw(out / f"{suite}-{name}.svg", {member: curves[member] for member in members}, axes, name)
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
render of its own from the first sample on, with a seed of its own; the seconds are the program's `seconds.render`, which leaves out
loading, baking, building the BVH and compiling shaders. The error is relMSE, mean of (a-b)²/(b²+0.01), against a long render by the
reference with another seed, less the part that this long render's own variance layer accounts for; so the figure is that against the
noiseless image. Passes over all sample counts are repeated, preview and reference in turn; line: median, band: lowest and highest.
Seconds to an error are interpolated between neighbouring points in the logarithms of both; *extrapolated* says that the series' time
ran out above the error, and that the last points' slope and cost per sample were carried on, 32-fold at most.""",
}


def document(reports):
    """docs/benchmarks.md as text."""
    text = INTRODUCTION
    for report in reports:
        suite = report["suite"]
        text += f"\n## {suite}\n\n" + (METHODS[suite] + "\n\n" if suite in METHODS else "")
        text += f"{report['date'][:10]}, revision {report['git']}, {report['cpu']}" + (f", {report['gl']}" if report["gl"] else "")
        text += ", short form (`--quick`)" * bool(report.get("quick"))
        text += busy(report) + ".\n\n"
        text += "| figure | value | target | | runs | note |\n| --- | ---: | ---: | --- | ---: | --- |\n"
        for (name, value, target, verdict, note), entry in zip(rows(report), report["figures"].values()):
            text += f"| `{name}` | {value} | {target} | {verdict} | {entry['runs']} | {note.replace('|', '/')} |\n"
        names = report.get("groups") or report["curves"]
        text += "".join(f"\n![{suite}, {name}](bench/{suite}-{name}.svg)\n" for name in names)
    return text


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
    options.document.write_text(document(reports))
    print(f"{options.document}: {', '.join(report['suite'] for report in reports)}")


if __name__ == "__main__":
    main()
