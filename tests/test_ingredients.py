"""The suite ingredients: its ladder, its figures, and the page made of them. What it measures is held by test_furnace.py.

Seen red with a rung that switches two ingredients."""
import sys

import pytest

import evaluate
import ingredient_tables

sys.path.insert(0, str(evaluate.ROOT / "tests" / "bench"))

import ingredients  # noqa: E402

TINY = ingredients.SHORT | {"fabrics": ("satin",), "texels": 64, "places": 64, "samples": 2, "angles": (0, 75), "footprints": (1, 64), "directions": 16}
# "stacked" is held to the plies instead (tests/bench/plies.py): light that has crossed a yarn is no part of the relief's truth.
DEFAULTS = {"ours": {"weight": "relief", "visibility": "horizon8", "slab": "ply", "unscattered": "true", "interreflection": "true", "twist_noise": "true"},
            "paper": {"weight": "mips", "visibility": "asg", "slab": "ply", "unscattered": "false", "interreflection": "false", "twist_noise": "true"}}


def full(keys):
    return DEFAULTS[keys.get("mode", "ours")] | {key: value for key, value in keys.items() if key != "mode"}


def differences(a, b):
    return sum(full(a)[key] != full(b)[key] for key in DEFAULTS["ours"])


def test_every_row_switches_one_ingredient():
    rungs = list(ingredients.LADDER.values())
    assert full(rungs[0]) == DEFAULTS["paper"] and full(rungs[-1]) == DEFAULTS["ours"]
    assert [differences(a, b) for a, b in zip(rungs, rungs[1:])] == [1] * (len(rungs) - 1)
    assert {differences(keys, rungs[0]) for keys in ingredients.FROM_PAPER.values()} == {1}
    assert {differences(keys, rungs[-1]) for keys in ingredients.FROM_OURS.values()} == {1}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SELVEDGE_CACHE", str(tmp_path_factory.mktemp("cache")))
        return ingredients.measure_visibility(TINY), ingredients.measure_reflectance(TINY)


def test_every_model_is_measured_in_every_cell(measured):
    visibility, reflectance = measured
    assert list(visibility["satin"]) == list(ingredients.KINDS)
    cells = reflectance["satin"]["cells"]
    assert [(cell["angle"], cell["footprint"]) for cell in cells] == [(0, 1), (0, 64), (75, 1), (75, 64)]
    for cell in cells:
        assert set(cell["models"]) == set(ingredients.MODELS)
    assert abs(ingredients.cells(reflectance["satin"], ingredients.OURS, "sky", 0, 64)[0]["error"]) < 0.2
    assert ingredients.cells(reflectance["satin"], "paper", "sky", 75, 64)[0]["error"] < -0.8


def test_the_page_names_every_model(measured):
    visibility, reflectance = measured
    cost = {renderer: {"cylinder_satin": {model: {"nanoseconds": 100.0, "over_first": 1.0, "low": 0.9, "high": 1.1, "ratios": [1.0]}
                                            for model in ingredients.MODELS}} for renderer in ("reference", "preview")}
    figures = ingredients.figures_of(visibility, reflectance, cost, TINY)
    assert {"visibility_rms.horizon8", "close_up_error_75.sky.ours", "meso_over_micro.preview.cylinder_satin.ours"} <= set(figures)
    page = ingredient_tables.document({"date": "2026-11-23", "git": "0", "cpu": "one", "gl": "none",
                                       "tables": ingredients.tables_of(visibility, reflectance, cost, TINY)})
    for model in ingredients.MODELS:
        assert page.count(f"| {model}") >= 7, model
    assert "| horizon8 |" in page


def test_models_take_turns_in_both_renderers():
    options = dict(TINY | {"side": 32, "rounds": 9, "timed": (ingredients.MICRO, ingredients.OURS)})
    cost = ingredients.measure_cost(options)
    for renderer in ("reference", "preview"):
        rows = cost[renderer][ingredients.SCENES[0]]
        assert list(rows) == [ingredients.MICRO, ingredients.OURS] and rows[ingredients.MICRO]["over_first"] == 1
        assert 0 < rows[ingredients.OURS]["low"] <= rows[ingredients.OURS]["over_first"] <= rows[ingredients.OURS]["high"]
    assert "llvmpipe" in options["gl"]
