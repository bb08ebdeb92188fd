"""Suite preview: what a frame costs, what each part that is left out saves, how soon there is a picture. Run by ./dev bench preview.

Times are those of the shipped program; pairs that are compared draw in turn, in one process (selvedge-turns)."""
import argparse
import json
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
from bench_report import figure  # noqa: E402

SCENES = {name: bench_report.ROOT / "assets" / "scenes" / f"{name}.json" for name in ("demo", "layers", "cylinder_satin")}
STRIPPED = pathlib.Path(__file__).with_name("stripped_shade.frag")
# Of the program with everything off: one matte plane that fills the picture, one point light.
BARE = {"camera": {"position": [0, 1, 0.01], "target": [0, 0, 0], "fov": 40}, "film": {"resolution": [512, 512]},
        "lights": [{"type": "point", "position": [0.3, 0.5, 0.2], "intensity": [2, 2, 2]}],
        "objects": [{"shape": "plane", "scale": 4, "matte": {"albedo": [0.5, 0.4, 0.3]}}]}
# Where each part is left out; matte and fabric alone.
SKIPS = {"plane_plain": ("lights", "matte", "model", "search", "shadows"), "cylinder_satin": ("lights", "matte", "model", "shadows", "unseen"),
         "sphere_matte": ("fabric", "gaps", "lights", "shadows"), "demo": ("lights", "model", "unseen")}
LONG = {"frames": 24, "rounds": 5, "turns": 200, "side": 256, "bare_side": 512, "resolutions": {"512": (512, 512), "1080p": (1920, 1080), "4K": (3840, 2160)},
        "pixels": 2.0e8, "equal_frames": 4096, "equal_size": 64}
SHORT = LONG | {"frames": 6, "rounds": 3, "turns": 40, "resolutions": {"512": (512, 512)}, "pixels": 1.5e6, "equal_size": 48}


class Bench:
    def __init__(self, folder, options):
        self.folder, self.options, self.gl = pathlib.Path(folder), options, ""

    def frame_ms(self, scene, *arguments, size=(256, 256), frames=None, environment=None):
        """Median milliseconds of a frame."""
        command = [bench_report.BIN / "selvedge-lookdev", scene, "--headless", "-o", self.folder / "out.exr", "--json", "-q", "--resolution",
                   "%d,%d" % size, "--frames", str(frames or self.options.frames), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | (environment or {}))
        if done.returncode != 0:
            sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}: {done.stderr}")
        report = json.loads(done.stdout)
        self.gl = ", ".join(report["gl"][key] for key in ("renderer", "version", "backend"))
        return report["milliseconds_per_frame"]["median"]

    def ratio(self, scene, dear, cheap, better="lower", target=None, side=None):
        """Figure of time of a frame with the settings `dear` over that with `cheap`."""
        report = bench_report.run_program("selvedge-turns", scene, "--renderer", "preview", "--side", side or self.options.side, "--rounds", self.options.turns,
                                          "--model", f"cheap:{cheap}", "--model", f"dear:{dear}")
        row = report["models"][1]
        return figure(row["over_first"], "x", better, target=target, runs=self.options.turns, note=f"{row['low']:.3f} to {row['high']:.3f} (95 %)")

    def frames_of_scenes(self):
        figures = {}
        for name, scene in SCENES.items():
            for label, size in self.options.resolutions.items():
                frames = max(3, min(self.options.frames, int(self.options.pixels / (size[0] * size[1]))))
                ms = statistics.median(self.frame_ms(scene, size=size, frames=frames) for _ in range(1 if label == "4K" else 2))
                figures[f"milliseconds_per_frame.{name}.{label}"] = figure(ms, "ms", "lower", runs=frames, note=f"{1e3 / ms:.3g} frames a second")
        return figures

    def skips(self):
        figures = {}
        for name, scene in SCENES.items():
            figures[f"specialised_over_general.{name}"] = self.ratio(scene, "", "keep=all", target=1.0)
        for name, skips in SKIPS.items():
            scene = bench_report.ROOT / "assets" / "scenes" / f"{name}.json"
            for skip in skips:
                figures[f"gain.{skip}.{name}"] = self.ratio(scene, f"keep={skip}", "", better="higher")
        return figures

    def stripped(self):
        """The scene that needs nothing, with our program and with a shader that has nothing; the pictures must be the same."""
        scene = self.folder / "bare.json"
        scene.write_text(json.dumps(BARE))
        glsl = self.folder / "glsl"
        shutil.copytree(bench_report.ROOT / "glsl", glsl)
        shutil.copy(STRIPPED, glsl / "shade.frag")
        environment = {"SELVEDGE_GLSL": str(glsl)}
        size, alike = (512, 512), ("--shade", "fragment")   # as the stripped one is
        bench_report.run_program("selvedge-lookdev", scene, "--headless", "-o", self.folder / "ours.exr", "--frames", 4, "-q", *alike)
        self.frame_ms(scene, *alike, size=size, frames=4, environment=environment)
        same = bench_report.run_program("selvedge-compare", self.folder / "ours.exr", self.folder / "out.exr", "--fail", "max_abs=inf")
        if same["relmse"] > 1e-10:
            sys.exit(f"preview: the stripped shader draws another picture: relMSE {same['relmse']}")
        return {"off_over_stripped": self.ratio(scene, "shade=fragment", f"shade=fragment,glsl={glsl}", target=1.02, side=self.options.bare_side)}

    def first_picture(self):
        """Seconds from the start of the program to its first picture on disk, with and without what the caches hold."""
        figures = {}
        for label, cold in (("", False), (".cold", True)):
            seconds = []
            for run in range(3):
                # Ours, Mesa's, NVIDIA's.
                environment = {"SELVEDGE_CACHE": str(self.folder / f"cache{run}"), "MESA_SHADER_CACHE_DIR": str(self.folder / f"mesa{run}"),
                               "__GL_SHADER_DISK_CACHE": "0"} if cold else {}
                start = time.monotonic()
                self.frame_ms(SCENES["demo"], size=(512, 512), frames=1, environment=environment)
                seconds.append(time.monotonic() - start)
            note = "no cache: fabrics are baked, shaders compiled" if cold else "fabrics and programs from the cache"
            figures["first_picture_seconds" + label] = figure(statistics.median(seconds), "s", "lower", runs=3, note="demo, 512 x 512; " + note)
        return figures

    def edits(self):
        """Seconds from a change until the picture with it is complete, as the window does it: one frame."""
        edits = {"camera": "camera -0.6 0.8 2.7 0.09 0.5 0", "light": "light 1 4 4 3", "yarn": "yarn 0 0.4 0.2 0.1"}
        figures, worst = {}, 0.0
        for name, edit in edits.items():
            commands = ["frames 2", edit, "frames 1", "now"]
            for _ in range(2 * self.options.rounds):
                commands += [edit, "frames 1", "now"]
            done = subprocess.run([bench_report.BIN / "selvedge-drive-preview", SCENES["demo"], "512,512"], input="\n".join(commands) + "\n",
                                  capture_output=True, text=True)
            if done.returncode != 0:
                sys.exit(f"preview: {done.stderr}")
            seconds = [float(word) for word in done.stdout.split()[1:]]
            worst = max(worst, statistics.median(seconds))
            figures[f"edit_to_picture_seconds.{name}"] = figure(statistics.median(seconds), "s", "lower", runs=len(seconds), note="demo, 512 x 512")
        return {"edit_to_picture_seconds": figure(worst, "s", "lower", note="the slowest of the following")} | figures

    def equality(self):
        """Preview against reference: the worst bias of a channel and the worst share of |z| > 3. Eight points a frame: the means of
        blocks of few samples are so skewed where light is rare that z says more of that than of bias."""
        bias, outliers = [], []
        size, count = self.options.equal_size, self.options.equal_frames
        common = ["--resolution", f"{size},{size}", "-q"]
        for name, scene in SCENES.items():
            bench_report.run_program("selvedge-lookdev", scene, "--headless", "-o", self.folder / "p.exr", "--frames", count, "--footprint-samples", 8, *common)
            bench_report.run_program("selvedge-render", scene, "-o", self.folder / "r.exr", "--spp", 16 * count, "--seed", 7, "--integrator", "direct", *common)
            found = bench_report.run_program("selvedge-compare", self.folder / "p.exr", self.folder / "r.exr", "--fail", "max_abs=inf")
            sigma = found["mean_relative_bias_sigma"]
            worst = max((found[f"mean_relative_bias.{channel}"] for channel in "RGB"), key=abs)
            bias.append((abs(worst), f"{name}: {worst:+.2%}, noise of the mean {sigma:.2%}"))
            outliers.append((found["z_outliers"], name))
        return {"max_bias": figure(*max(bias)[:1], "", "lower", target=0.002, note=max(bias)[1]),
                "max_z_outliers": figure(max(outliers)[0], "", "lower", target=0.006, note=max(outliers)[1])}


def measure(suite, parts, only):
    """The figures of the parts that are asked for, all of them where nobody says."""
    figures = {}
    for name, part in parts.items():
        if only and name not in only:
            continue
        start = time.monotonic()
        figures |= part()
        print(f"{suite}: {name}, {time.monotonic() - start:.0f} s", file=sys.stderr)
    return figures


def main():
    parser = argparse.ArgumentParser(description="Cost of a frame, gain of each skip, time to the first picture.")
    parser.add_argument("--quick", action="store_true", help="the short form: 9 minutes, most of them for the equality with the reference")
    parser.add_argument("--only", action="append", choices=("frames", "skips", "stripped", "first", "edits", "equality"), help="repeatable; default all")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    options = parser.parse_args()
    for name, value in (SHORT if options.quick else LONG).items():
        setattr(options, name, value)
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as folder:
        bench = Bench(folder, options)
        parts = {"frames": bench.frames_of_scenes, "skips": bench.skips, "stripped": bench.stripped,
                 "first": bench.first_picture, "edits": bench.edits, "equality": bench.equality}
        figures = measure("preview", parts, options.only)
        bench_report.write("preview", figures, {}, out=options.out, load=load, gl=bench.gl, quick=options.quick)


if __name__ == "__main__":
    main()
