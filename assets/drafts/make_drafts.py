#!/usr/bin/env python3
"""Writes this folder's WIF drafts. They are our own work, drawn from the rules of each weave; run it to make them again."""
import pathlib

HERE = pathlib.Path(__file__).parent

CHARCOAL, CREAM = (78, 76, 80), (244, 240, 232)
GREY, OATMEAL = (142, 140, 143), (218, 211, 198)
INDIGO, ECRU = (72, 90, 138), (232, 226, 212)
WINE, ROSE = (126, 22, 40), (236, 168, 160)


def twill_threading(ends):
    """Straight draw on four shafts."""
    return [e % 4 + 1 for e in range(ends)]


def herringbone_threading(ends):
    """Half of the ends drawn straight, half the other way, with a broken edge: the lines meet offset by two shafts."""
    return [e % 4 + 1 for e in range(ends // 2)] + [(1 - e) % 4 + 1 for e in range(ends // 2)]


def point_threading(ends):
    """Up and down again without doubling the turning shafts; ends = 2 (shafts - 1)."""
    shafts = ends // 2 + 1
    return list(range(1, shafts + 1)) + list(range(shafts - 1, 1, -1))


def balanced_tieup(shafts):
    """2/2-like: each treadle lifts half of the shafts, moved on by one."""
    return [[(t + k) % shafts + 1 for k in range(shafts // 2)] for t in range(shafts)]


DRAFTS = {
    # name: title, threading, tie-up, treadling, colours, warp colours, weft colours, spacing cm, thickness cm
    "herringbone": ("Herringbone 2/2, grey warp, oatmeal weft", herringbone_threading(16), balanced_tieup(4),
                    twill_threading(4), [GREY, OATMEAL], [1] * 16, [2] * 4, 0.08, 0.07),
    "houndstooth": ("Houndstooth: 2/2 twill, four dark, four light both ways", twill_threading(8), balanced_tieup(4),
                    twill_threading(8), [CHARCOAL, CREAM], [1] * 4 + [2] * 4, [1] * 4 + [2] * 4, 0.09, 0.084),
    "goose_eye": ("Goose eye: point twill on four shafts, six ends and picks", point_threading(6), balanced_tieup(4),
                  point_threading(6), [WINE, ROSE], [1] * 6, [2] * 6, 0.05, 0.046),
    "denim": ("Denim 3/1, indigo warp, ecru weft", twill_threading(4), [[t % 4 + 1, (t + 1) % 4 + 1, (t + 2) % 4 + 1] for t in range(4)],
              twill_threading(4), [INDIGO, ECRU], [1] * 4, [2] * 4, 0.040, 0.039),
}


def wif(title, threading, tieup, treadling, colours, warp_colours, weft_colours, spacing_cm, thickness_cm):
    section = lambda name, rows: [f"[{name}]"] + [f"{key}={value}" for key, value in rows] + [""]
    numbered = lambda values: [(i, v) for i, v in enumerate(values, 1)]
    listed = lambda values: ",".join(str(v) for v in values)
    system = lambda threads: [("Threads", threads), ("Units", "centimeters"), ("Spacing", f"{spacing_cm:g}"), ("Thickness", f"{thickness_cm:g}")]
    contents = ["TEXT", "WEAVING", "WARP", "WEFT", "COLOR PALETTE", "COLOR TABLE", "THREADING", "TIEUP", "TREADLING", "WARP COLORS", "WEFT COLORS"]
    lines = section("WIF", [("Version", "1.1"), ("Date", "April 20, 1997"), ("Developers", "wif@mhsoft.com"), ("Source Program", "selvedge make_drafts.py"), ("Source Version", "1")])
    lines += section("CONTENTS", [(name, "true") for name in contents])
    lines += section("TEXT", [("Title", title)])
    lines += section("WEAVING", [("Shafts", max(threading)), ("Treadles", len(tieup)), ("Rising Shed", "true")])
    lines += section("WARP", system(len(threading))) + section("WEFT", system(len(treadling)))
    lines += section("COLOR PALETTE", [("Entries", len(colours)), ("Form", "RGB"), ("Range", "0,255")])
    lines += section("COLOR TABLE", numbered(map(listed, colours)))
    lines += section("THREADING", numbered(threading)) + section("TIEUP", numbered(map(listed, tieup)))
    lines += section("TREADLING", numbered(treadling))
    lines += section("WARP COLORS", numbered(warp_colours)) + section("WEFT COLORS", numbered(weft_colours))
    return "\n".join(lines)


if __name__ == "__main__":
    for name, draft in DRAFTS.items():
        (HERE / f"{name}.wif").write_text(wif(*draft))
