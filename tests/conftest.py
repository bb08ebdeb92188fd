"""What all tests share. A skipped test counts as failed: a skip hides a missing piece and looks green."""
import os
import pathlib
import subprocess
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).parent))

import evaluate  # noqa: E402

ROOT = evaluate.ROOT
# Files of other owners, kept beside the checkout. Where the folder is absent, the tests that take its files are not collected;
# where it is there, they run, and the session fails unless some did.
DATA = pathlib.Path(os.environ.get("SELVEDGE_DATA", ROOT.parent / "shared" / "data"))


def pytest_configure(config):
    config.addinivalue_line("markers", "shared_data: reads files of $SELVEDGE_DATA")
    config.shared_data_ran = 0


def pytest_collection_modifyitems(config, items):
    if not DATA.is_dir():
        absent = [item for item in items if item.get_closest_marker("shared_data")]
        items[:] = [item for item in items if item not in absent]
        config.hook.pytest_deselected(items=absent)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.skipped:
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid}: skipped, which counts as failed: {call.excinfo.value if call.excinfo else ''}"
    if report.when == "call" and item.get_closest_marker("shared_data"):
        item.config.shared_data_ran += 1
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    report = yield
    if report.skipped:
        report.outcome = "failed"
        report.longrepr = f"{collector.nodeid}: skipped as a whole, which counts as failed"
    return report


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    chosen = session.config.option.keyword or session.config.option.collectonly or session.config.option.file_or_dir != ["tests"]
    if exitstatus == 0 and not chosen and DATA.is_dir() and session.config.shared_data_ran == 0:
        print(f"\n{DATA} is there and no test used it", file=sys.stderr)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(scope="session")
def evaluator(tmp_path_factory):
    """No context, no program: an error, never a skip."""
    return evaluate.Evaluator(tmp_path_factory.mktemp("evaluate"))


@pytest.fixture(params=evaluate.BUILDS)
def build(request):
    return request.param


@pytest.fixture(scope="session")
def shared_data():
    return DATA


@pytest.fixture
def bake(program, tmp_path):
    """bake(arguments…) -> CompletedProcess of selvedge-bake, with a cache of its own."""
    environment = os.environ | {"SELVEDGE_CACHE": str(tmp_path / "cache")}
    return lambda *arguments: subprocess.run([program("bake"), *map(str, arguments)], capture_output=True, text=True, timeout=120,
                                             env=environment, cwd=tmp_path)


@pytest.fixture(scope="session")
def program():
    """program("bake") -> path of selvedge-bake."""
    return lambda verb: evaluate.BIN / f"selvedge-{verb}"
