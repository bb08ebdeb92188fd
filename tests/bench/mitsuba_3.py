"""Suite mitsuba-3: efficiency against an independent renderer. Run by ./dev bench mitsuba-3."""
import argparse
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_mitsuba  # noqa: E402
import bench_report  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description="1 / (relMSE x seconds) of selvedge-render over that of Mitsuba 3.")
    parser.add_argument("--quick", action="store_true", help="the short form: less than 3 minutes")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    options = parser.parse_args()
    load = bench_report.other_load()
    bench_report.write("mitsuba-3", bench_mitsuba.figures(options.quick), {}, out=options.out, load=load, quick=options.quick)


if __name__ == "__main__":
    main()
