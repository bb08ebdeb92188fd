"""The layout holds: imports go one way, each foreign library has one door, and shading mathematics lives in glsl/ alone."""
import pathlib
import re
import subprocess

import pytest

import evaluate
import shader_source

ROOT = evaluate.ROOT
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.M)
# A folder may include itself and those below it. tests/ may include all.
LAYERS = ["glsl", "bake", "reference", "app"]


def sources(*folders, suffixes=(".h", ".hpp", ".cpp")):
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*")) if path.suffix in suffixes]


def includes(path):
    """(quoted, name) of every include."""
    return [(mark == '"', name) for mark, name in INCLUDE.findall(path.read_text())]


def layer_of(path, name):
    """The folder that a quoted include leads to: from the root, beside the file, or in glsl/, as CMake's include folders say."""
    for base in (path.parent, ROOT, ROOT / "glsl"):
        found = (base / name).resolve()
        if found.is_file() and ROOT in found.parents:
            return found.relative_to(ROOT).parts[0]
    return None


def test_includes_go_one_way():
    wrong = []
    for path in sources(*LAYERS):
        own = LAYERS.index(path.relative_to(ROOT).parts[0])
        for quoted, name in includes(path):
            layer = layer_of(path, name) if quoted else None
            if layer is not None and (layer not in LAYERS or LAYERS.index(layer) > own):
                wrong.append(f"{path.relative_to(ROOT)} includes {name}, which is in {layer}/")
            if quoted and layer is None and name not in ("revision.hpp",):
                wrong.append(f"{path.relative_to(ROOT)} includes {name}, which is nowhere in the tree")
    assert not wrong, "\n".join(wrong)


def test_preview_and_reference_do_not_see_each_others_renderers():
    """Both read Scene; what draws it is each one's own."""
    wrong = [f"{path.relative_to(ROOT)}: {name}" for path in sources("app/preview") for _, name in includes(path)
             if re.search(r"reference/(integrator|checkpoint)", name)]
    wrong += [f"{path.relative_to(ROOT)}: {name}" for path in sources("reference") for _, name in includes(path) if "preview" in name]
    assert not wrong, wrong


DOORS = {
    r"embree|rtcore": {"reference/embree.hpp"},
    r"OpenImageIO/(?!oiioversion)": {"bake/image.cpp", "bake/display.cpp"},
    r"assimp/": {"reference/mesh.cpp"},
    r"imgui": {"app/"},
    r"GLFW/": {"app/"},
    r"epoxy|EGL/|GL/|osmesa": {"app/"},
    r"CLI/": {"bake/bake_main.cpp", "bake/program.cpp", "reference/render_options.cpp", "reference/compare_main.cpp", "app/main.cpp"},
    r"nlohmann": {"bake/", "reference/render_main.cpp", "reference/compare_main.cpp", "app/"},
}


@pytest.mark.parametrize("library", DOORS)
def test_each_library_has_one_door(library):
    wrong = [f"{path.relative_to(ROOT)} includes {name}" for path in sources(*LAYERS) for quoted, name in includes(path)
             if not quoted and re.match(library, name) and not any(str(path.relative_to(ROOT)).startswith(door) for door in DOORS[library])]
    assert not wrong, "\n".join(wrong)


def test_shared_headers_include_nothing_foreign():
    """What three languages read includes only its like."""
    for path in sources("glsl", suffixes=(".h",)):
        for quoted, name in includes(path):
            assert quoted and (ROOT / "glsl" / name).is_file(), f"{path.name} includes {name}"


def without_comments(text):
    return re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.S)


def test_shading_mathematics_is_in_glsl_alone():
    """Words that only a BSDF, a sampler or a horizon look-up has to say. A call is not a definition: cloth_ names are left out."""
    words = re.compile(r"\b(?!cloth_)\w*(sggx|vndf|spongecake|henyey|fresnel|microflake|lambertian)\w*", re.I)
    wrong = []
    for path in sources("bake", "reference", "app"):
        for hit in words.finditer(without_comments(path.read_text())):
            wrong.append(f"{path.relative_to(ROOT)}: {hit[0]}")
    assert not wrong, wrong


def test_shader_roots_define_no_shared_function():
    """Roots are includes in their order, then main: no function of theirs is one that the shared headers define."""
    shared = {name for path in sources("glsl", suffixes=(".h",)) for name in re.findall(r"\b(cloth_\w+)\(", path.read_text())}
    for path in sources("glsl", suffixes=(".vert", ".frag", ".comp")):
        defined = set(re.findall(r"^\w[\w ]*\b(\w+)\([^;{]*\)\s*\{", without_comments(path.read_text()), re.M))
        assert not defined & shared, f"{path.name} defines {defined & shared}"


def test_every_file_says_what_it_holds():
    for path in sources("glsl", *LAYERS[1:], "tests/cpp", suffixes=(".h", ".hpp", ".cpp", ".vert", ".frag", ".comp")):
        assert path.read_text().startswith("//"), f"{path.relative_to(ROOT)}: the first line is no comment"


def test_no_vague_names_and_no_loose_ends():
    vague = re.compile(r"(^|_)(utils?|common|helpers?|managers?|misc)(_|$)")
    for path in [*sources(*LAYERS, "tests/cpp"), *(ROOT / "tests").glob("*.py")]:
        assert not vague.search(path.stem), path
        text = path.read_text()
        if path != pathlib.Path(__file__):
            assert not re.search(r"\bTODO\b|\bFIXME\b|#if 0|pytest\.(mark\.)?skip|importorskip", text), path


def roots():
    return sorted(path.name for suffix in ("vert", "frag", "comp") for path in (ROOT / "glsl").glob(f"*.{suffix}"))


def test_there_are_shader_roots():
    assert roots()


@pytest.mark.parametrize("name", roots())
def test_both_include_loaders_give_the_same_text(name, program):
    files = []
    text = shader_source.load(name, [ROOT / "glsl"], files)
    done = subprocess.run([program("shader-text"), ROOT / "glsl", name], capture_output=True, text=True, check=True)
    cpp, _, names = done.stdout.partition("\n// file ")
    assert cpp.rstrip("\n") == text.rstrip("\n")
    assert [file.strip() for file in names.split("\n// file ")] == files
