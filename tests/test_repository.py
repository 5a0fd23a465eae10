"""Rules of the house that hold for every file, as docs/architecture.md states them."""

import ast
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from benchmarks.pythons import SUPPORTED

import pa10cal
from pa10cal.commands.doctor import LEAST_PYTHON
from pa10cal.terms.plain import term_kinds
from pa10cal_lab.cell.effects.vocabulary import all_effects

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
PACKAGE = SOURCE / "pa10cal"
PACKAGES = {path.parent.name for path in PACKAGE.glob("*/*.py")}
#: Packages beside it, which import it.
BESIDE = ("pa10cal_curve", "pa10cal_lab")
MODULES = [
    path for name in (PACKAGE.name, *BESIDE) for path in sorted((SOURCE / name).rglob("*.py"))
]
CODE = [
    *MODULES,
    *sorted((ROOT / "tests").rglob("*.py")),
    *sorted((ROOT / "benchmarks").rglob("*.py")),
]
PURE = {
    "numerics",
    "arm",
    "terms",
    "frame",
    "calibration",
    "discovery",
    "montecarlo",
    "evaluation",
    *(f"pa10cal_curve.{n}" for n in ("angles", "curve", "gait", "points", "postures", "roll")),
}
FLOOR = {
    "arrays",
    "numerics",
    "errors",
    "input_files",
    "results",
    "settings_reading",
    "options",
    "rules",
    "yaml_file",
}

#: What a package may import besides itself and `errors`: packages, or single modules.
MAY_IMPORT = {
    "settings": {"calibration.options", "command_settings"},
    "command_settings": {"calibration.options"},
    "settings_reading": set(),
    "input_files": set(),
    "yaml_file": set(),
    "numerics": set(),
    "options": set(),
    "results": {"files.output", "files.table_cells"},
    "arm": set(),
    "terms": {"arm"},
    "frame": set(),
    "observe": {"arm", "terms", "frame"},
    "campaign": {
        "files.table_cells",
        "arm",
        "files.arms",
        "files.controller",
        "files.coupling",
        "fit.weighed_arm",
        "frame",
        "observe",
        "settings",
    },
    "calibration": {
        "arm",
        "campaign.column_map",
        "campaign.conventions",
        "campaign.description",
        "campaign.raw_file",
        "campaign.target_labels",
        "files.coupling",
        "fit",
        "frame",
        "observe",
        "terms",
    },
    "fit": {"arm", "files.output", "files.table_cells", "frame", "observe", "terms"},
    "discovery": {
        "arm",
        "calibration",
        "campaign.description",
        "fit",
        "frame",
        "observe",
        "terms",
    },
    "montecarlo": {"arm"},
    "pa10cal_curve": {
        "arm.description",
        "calibration",
        "campaign",
        "discovery",
        "evaluation",
        "figures",
        "files",
        "fit",
        "reports",
        "pa10cal_lab",
    },
    "evaluation": {
        "arm",
        "calibration",
        "campaign",
        "discovery",
        "fit",
        "frame",
        "montecarlo",
        "observe",
        "terms",
    },
    "pa10cal_lab.cell": {"arm.description", "files", "observe.kinds", "pa10cal_lab.trial_records"},
    "pa10cal_lab": {
        "arm",
        "calibration",
        "campaign",
        "command_settings",
        "stages",
        "discovery",
        "evaluation",
        "figures",
        "files",
        "fit",
        "options",
        "observe",
        "reports.theme",
        "terms",
    },
    "datasets": {"campaign", "files", "settings"},
    "files": {
        "arm.chain",
        "arm.coupling",
        "arm.description",
        "arm.dh_rows",
        "arm.urdf_import",
        "arm.urdf_writing",
        "arm.ur_calibration",
        "arm.urdf_ends",
        "settings",
    },
    "figures": {
        "arm",
        "campaign.description",
        "campaign.table",
        "command_settings",
        "files",
        "options",
        "observe",
        "reports",
        "settings",
    },
    "running": {"files.output", "results", "settings"},
    "fleet": {
        "calibration.options",
        "options",
        "evaluation",
        "files.table_cells",
        "fit",
        "reports.summary",
    },
    "reports": {
        "command_settings",
        "observe.instrument",
        "observe.quantities",
        "observe.kinds",
        "campaign.description",
        "campaign.table",
        "arm.coupling",
        "terms.joint_spring",
        "files.output",
        "terms.wording",
    },
    "pose_plan": {
        "arm",
        "calibration",
        "campaign.joint_positions",
        "discovery",
        "files.output",
        "files.table_cells",
        "fit",
        "observe",
        "terms",
    },
    "stages": {
        "command_settings",
        "arm",
        "calibration",
        "campaign",
        "discovery",
        "evaluation",
        "files",
        "fit",
        "frame",
        "observe",
        "results",
        "terms",
    },
    "planning": {
        "calibration.options",
        "files",
        "fit.covariance_file",
        "fit.model_reading",
        "observe.kinds",
        "running.run_lock",
    },
}
#: Libraries that only some packages or modules may import.
KEPT_TO = {
    "jinja2": {"reports"},
    "markupsafe": {"reports"},
    "matplotlib": {"figures", "pa10cal_curve", "pa10cal_lab.pictures"},
    "pinocchio": {"arm.urdf_import"},
    "plotly": {"reports"},
    "snakemake": set(),
}
NOT_IN_PURE = {"pandas", "pyarrow", "yaml", "json", "csv", "pathlib", "os", "sys"}


def name_of(path):
    """Return a module's name, without that of the first package: `arm.chain`."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return short(".".join(parts[:-1] if parts[-1] == "__init__" else parts))


def short(module):
    """Return the full name of a module as `name_of` has it."""
    return "" if module == PACKAGE.name else module.removeprefix(f"{PACKAGE.name}.")


class Facts(NamedTuple):
    """What rules look at in a module. Trees are not kept: collecting garbage would walk them."""

    imports: tuple[str, ...]  # `from a import b` as `a.b`
    words: frozenset[str]  # constants that are text
    calls: frozenset[str]  # functions called by a plain name
    lists: tuple[frozenset[str], ...]  # constants in each list, tuple, set, or among keys


@cache
def facts_of(path):
    """Look at a module once for all rules."""
    imports, words, calls, lists = [], set(), set(), []
    text, own = path.read_text("utf-8"), r"^ *((?:from|import) pa10cal[^(\n]*(?:\([^)]*\))?)"
    if not path.is_relative_to(SOURCE):  # of others only what they import counts
        text = "\n".join(re.findall(own, text, re.MULTILINE))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            imports += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            imports += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            words.add(node.value)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            calls.add(node.func.id)
        elif isinstance(node, ast.Dict | ast.Tuple | ast.List | ast.Set):
            each = node.keys if isinstance(node, ast.Dict) else node.elts
            texts = [one.value for one in each if isinstance(one, ast.Constant)]
            lists.append(frozenset(text for text in texts if isinstance(text, str)))
    return Facts(tuple(imports), frozenset(words), frozenset(calls), tuple(lists))


@cache
def own_imports(path):
    """Return the modules of this project that are imported, as `name_of` has them."""
    found = facts_of(path).imports
    return tuple(short(m) for m in found if re.match(rf"{PACKAGE.name}(_\w+)?\b", m))


def within(module, places):
    """Say whether a module is one of the places or lies in one."""
    return any(module == place or module.startswith(f"{place}.") for place in places)


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_run_downward(package):
    allowed = MAY_IMPORT[package] | FLOOR | {package}
    wrong = [
        f"{name_of(path)} imports {module}"
        for path in MODULES
        if within(name_of(path), {package})
        for module in own_imports(path)
        if module not in ("", "__version__") and not within(module, allowed)
    ]
    assert not wrong


def test_every_package_has_its_place():
    assert {path.name for path in SOURCE.glob(f"{PACKAGE.name}_*")} == set(BESIDE)
    assert (PACKAGES - {"commands"}) | set(BESIDE) <= set(MAY_IMPORT)
    table = re.findall(r"^\| `(\w+)/?` ", (ROOT / "docs/architecture.md").read_text("utf-8"), re.M)
    assert PACKAGES | set(BESIDE) <= set(table)


#: Where packages beside the first are named: tables of modules that are looked up when needed.
TABLES = {"commands.command_line", "figures.registry", "settings"}


def test_the_package_imports_none_of_those_beside_it():
    every = sorted(PACKAGE.rglob("*.py"))
    assert not [path for path in every if any(within(m, BESIDE) for m in own_imports(path))]
    first = {name_of(path): {word.split(".")[0] for word in facts_of(path).words} for path in every}
    naming = {name for name, words in first.items() if words & {*BESIDE}}
    assert naming == TABLES, "one way to find what stands beside"


@pytest.mark.parametrize("library", KEPT_TO)
def test_a_library_stays_where_it_belongs(library):
    users = {
        name_of(path) for path in MODULES for m in facts_of(path).imports if within(m, {library})
    }
    assert not {user for user in users if not within(user, KEPT_TO[library])}


def test_pure_packages_know_no_files_no_settings_and_do_not_print():
    wrong = []
    for path in MODULES:
        if not within(name_of(path), PURE):
            continue
        facts = facts_of(path)
        wrong += [f"{path.name}: {m}" for m in facts.imports if within(m, NOT_IN_PURE)]
        wrong += [f"{path.name}: {name}()" for name in facts.calls & {"print", "open"}]
    assert not wrong


#: Which effects trials hide, in the order in which they go through them or draw from them.
TRIALS = {"pa10cal_lab.cell.measured_trials", "pa10cal_lab.cell.trials"}


def test_no_effects_are_listed_by_hand():
    """What is to be known of an effect by its id, its class states."""
    known = {*term_kinds(), *all_effects()}
    for path in MODULES:
        listed = [sorted(ids & known) for ids in facts_of(path).lists if len(ids & known) > 1]
        assert not listed or name_of(path) in TRIALS, path


#: How a table could be written beside `files.table_cells.csv_text`.
WRITES_CSV = re.compile(r"csv\.(?:Dict)?[Ww]riter\b|\.to_csv\(|savetxt\(|[\"'],[\"']\.join\b")


def test_tables_go_out_through_one_writer():
    wrong = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in MODULES
        for number, line in enumerate(path.read_text("utf-8").splitlines(), start=1)
        if WRITES_CSV.search(line)
    ]
    writers = [each.rpartition(":")[0] for each in wrong]
    assert writers == ["src/pa10cal/files/table_cells.py"], wrong


def test_no_private_name_crosses_modules():
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in CODE
        for module in own_imports(path)
        if re.search(r"\._(?!_)", module)
    ]
    assert not wrong


LEAFLETS = 35  # modules of fewer than 60 lines, those that only mark a package among them


def test_no_module_is_longer_than_600_lines_and_leaflets_only_become_fewer():
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in CODE}
    assert not [path for path in CODE if lines[path] > 600]
    short = [path for path in MODULES if lines[path] < 60]
    assert len(short) == LEAFLETS, "join a new one to the one it serves; of fewer, write the number"


def test_nothing_imports_itself_by_way_of_others():
    """Imports for types alone and those inside functions count like any other."""
    names = {name_of(path) for path in MODULES}

    def module_of(imported):
        return imported if imported in names else imported.rpartition(".")[0]

    every = {
        name_of(path): set(map(module_of, own_imports(path))) - {name_of(path)} for path in MODULES
    }
    assert not circles(every)
    packages = {}
    for name, imported in every.items():
        top = name.partition(".")[0]
        others = {each.partition(".")[0] for each in imported} - {top}
        packages.setdefault(top, set()).update(others)
    assert not circles(packages)


def circles(graph):
    """Return the sets of nodes that reach each other (Tarjan, 1972)."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            if len(stack) > at + 1:
                found.append(stack[at:])
            del stack[at:]

    for node in graph:
        if node not in index:
            visit(node)
    return found


def test_rules_only_call_commands():
    for path in (ROOT / "Snakefile", *(ROOT / "workflow/rules").glob("*.smk")):
        text = path.read_text("utf-8")
        assert not re.search(r"^\s*(run|script|notebook|wrapper):", text, re.MULTILINE), path
        commands = re.findall(r"shell:\s+\"(.*)", text)
        assert all(command.startswith("python -m pa10cal ") for command in commands), path


LOCKS = "requirements.lock", "users.lock"


def plain(name):
    """Return the name of a package, whatever its versions, as locks write it."""
    return re.sub(r"[-_.]+", "-", re.split(r"[<>=!~ ;]", name)[0]).lower()


def locked(name):
    """Each package of a lock, with its version and hashes."""
    text = (ROOT / name).read_text("utf-8")
    found = re.findall(r"^([A-Za-z0-9._-]+)(?:\[[\w,-]+\])?(==[^#]*)", text, re.MULTILINE)
    return {(plain(package), pinned) for package, pinned in found}


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_pins_every_package_by_hash_and_names_no_address(lock):
    text = (ROOT / lock).read_text("utf-8")
    assert "://" not in text
    assert not re.search(r"^-", text, re.MULTILINE), "an option of pip, such as an index"
    assert not re.search(r"\b[\w-]+\.(org|com|io|net)\b", text)
    requirements = re.split(r"\n(?=\S)", text.strip())
    assert len(requirements) > 50
    for requirement in requirements:
        assert re.match(r"[A-Za-z0-9._-]+(\[[\w,-]+\])?==\S+", requirement), requirement[:60]
        assert "--hash=sha256:" in requirement, requirement[:60]


def test_locks_hold_every_dependency_and_that_of_users_no_tool():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = {
        name: {plain(package) for package in packages}
        for name, packages in project["optional-dependencies"].items()
    }
    everything, users = (locked(name) for name in LOCKS)
    assert users < everything, "another version or other hashes"
    # Few users need the readers of takes and bags.
    tools = set().union(*(extras.pop(name) for name in ("dev", "docs", "c3d", "bags")))
    wanted = {plain(name) for name in project["dependencies"]}.union(*extras.values())
    assert wanted <= {name for name, _ in users}
    assert wanted | tools <= {name for name, _ in everything}
    assert not (tools - wanted) & {name for name, _ in users}


def test_one_version_stands_everywhere():
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    version, date = re.search(r"^## (\S+), (.+)$", changes, re.MULTILINE).groups()
    assert version == pa10cal.__version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == version
    assert f"{citation['date-released']:%d %B %Y}".lstrip("0") == date
    assert f"newest release, {version}, " in (ROOT / "SECURITY.md").read_text("utf-8")


def test_the_supported_pythons_are_the_same_everywhere():
    configuration = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    project, tools = configuration["project"], configuration["tool"]
    named = [re.search(r" :: Python :: (3\.\d+)$", each) for each in project["classifiers"]]
    supported = [found[1] for found in named if found]
    assert supported == [f"{major}.{minor}" for major, minor in SUPPORTED]
    least = supported[0]
    assert project["requires-python"] == f">={least}"
    assert tools["mypy"]["python_version"] == least
    assert tools["ruff"]["target-version"] == "py" + least.replace(".", "")
    assert ".".join(map(str, LEAST_PYTHON)) == least
    assert f"older than Python {least};" in (ROOT / "Makefile").read_text("utf-8")
    said = f"Python {', '.join(supported[:-1])} {{}} {supported[-1]}"
    assert f"You need {said.format('or')}. " in (ROOT / "README.md").read_text("utf-8")
    assert f"under {said.format('and')} " in (ROOT / "SECURITY.md").read_text("utf-8")


def test_hooks_before_a_commit_are_local_tools_of_the_lock():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    tools = set(project["optional-dependencies"]["dev"])
    for repository in hooks["repos"]:
        assert repository["repo"] == "local"
        for hook in repository["hooks"]:
            assert Path(hook["entry"].split()[0]).parts[:2] == (".venv", "bin")
            assert Path(hook["entry"].split()[0]).name in tools


@pytest.mark.parametrize(
    "command",
    [
        "stages/readings",
        "stages/calibrate",
        "commands/montecarlo",
        "stages/discover",
        "stages/pipeline",
        "stages/evaluate",
        "stages/export",
        "commands/figures",
    ],
)
def test_estimating_commands_know_nothing_of_the_cell_or_its_truth(command):
    path = PACKAGE / f"{command}.py"
    assert not [module for module in own_imports(path) if within(module, BESIDE)]
    assert "truth" not in path.read_text(encoding="utf-8")


def test_every_decision_has_a_number_of_its_own():
    numbers = []
    for path in sorted((ROOT / "docs/decisions").glob("*.md")):
        title = path.read_text("utf-8").splitlines()[0]
        numbers.append(int(path.name[:4]))
        assert title.startswith(f"# {numbers[-1]}. "), path.name
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_page_stands_in_the_table_of_contents():
    """`make docs` would say so too; this says it sooner."""
    docs = ROOT / "docs"
    pages = {str(p.relative_to(docs).with_suffix("")) for p in docs.rglob("*.md")}
    pages = {page for page in pages if not page.startswith("decisions/")}
    contents = "".join(
        (docs / page).read_text("utf-8") for page in ("index.md", "benchmarks/index.md")
    )
    listed = set(re.findall(r"^([\w/-]+)$", contents, re.MULTILINE))
    listed |= {f"benchmarks/{page}" for page in listed}
    assert pages - listed == {"STATUS", "index"}
    measured = {f"benchmarks/{path.stem}" for path in (ROOT / "benchmarks").glob("*.md")}
    assert measured <= pages


def test_pages_and_modules_that_are_named_exist():
    named = {
        page
        for path in (*PROSE, *CODE, *(ROOT / "workflow").rglob("*.smk"))
        for page in re.findall(r"\b(docs/[\w/-]+\.md)\b", path.read_text("utf-8"))
    }
    assert not [page for page in sorted(named) if not (ROOT / page).is_file()]
    files = "".join(f"/{path}\n" for path in (*CODE, *ROOT.glob("[de]*s/**/*.py")))
    for page in PROSE:
        modules = re.findall(r"`([\w.-]+/[\w./-]+\.py)`", page.read_text("utf-8"))
        assert not [name for name in modules if f"/{name}\n" not in files], page


PROSE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted(ROOT.glob("docs/*/*.md")),
]


def test_no_line_of_prose_is_longer_than_120_characters():
    """Tables and code may be longer, and the address of a link does not count."""
    for page in PROSE:
        text = re.sub("^```.*?^```$", "", page.read_text("utf-8"), flags=re.M | re.S)
        shown = re.sub(r"^\|.*|(?<=\])\([^)\n]*\)", "", text, flags=re.M).splitlines()
        assert not [line for line in shown if len(line) > 120], page


def test_the_picture_of_the_architecture_shows_every_package():
    picture = (ROOT / "docs/architecture.svg").read_text("utf-8")
    shown = (PACKAGES - {"stages"}) | set(BESIDE)
    missing = [name for name in shown if f">{name}/<" not in picture]
    assert not missing, "draw it anew: python docs/_site/structure.py"
