"""What users install: sdist and wheel from a clean tree, and a wheel that works away from the checkout."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from configparser import ConfigParser
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
WHEEL_TESTS = ("test_se2.py", "test_registry.py", "models/test_odometry.py")


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Standard output of a command that must succeed."""
    keep = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV_"))}
    done = subprocess.run(command, cwd=cwd, env=keep | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def sources() -> set[str]:
    """The import package's files, as a wheel should hold them."""
    found = set()
    for folder, _, names in os.walk(ROOT / "slamkit", followlinks=True):
        found |= {(Path(folder) / n).relative_to(ROOT).as_posix() for n in names if n.endswith((".py", "py.typed"))}
    return found


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """An sdist from a clean copy of the tree, and a wheel from that sdist."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("needs a git checkout: what belongs to the tree is asked of git")
    if Version(version("setuptools")) < Version("77"):
        pytest.skip(f"building needs setuptools >= 77, this environment has {version('setuptools')}")
    tree = tmp_path_factory.mktemp("tree")
    names = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT).split("\0")
    for name in filter(None, names):
        source = ROOT / name
        if source.is_symlink() or source.exists():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, tree / name, follow_symlinks=False)
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, tree, cwd=out)
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="session")
def installed(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an environment with the wheel; the dependencies are those of the running environment."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=os.name != "nt")
    python = executable(folder, "python")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(python))
    run(*pip, "install", "--quiet", "--no-index", "--no-deps", built[1], cwd=folder)
    # Lines of .pth files inside the borrowed folder are not read: an editable slamkit there stays out of sight.
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    borrowed = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(borrowed)), encoding="utf-8")
    return folder


def executable(environment: Path, name: str) -> Path:
    scripts = sysconfig.get_path("scripts", "venv", {"base": str(environment), "platbase": str(environment)})
    return Path(scripts) / (name + (".exe" if os.name == "nt" else ""))


def test_wheel_holds_exactly_the_import_package(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as wheel:
        held = {n for n in wheel.namelist() if ".dist-info/" not in n}
    assert held == sources()
    assert {"slamkit/py.typed", "slamkit/models/py.typed", "slamkit/models/unicycle.py"} <= held


def test_sdist_holds_what_a_build_and_its_tests_need(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[0]) as sdist:
        held = {n.partition("/")[2] for n in sdist.getnames()}
    assert {f for f in sources() if not f.startswith("slamkit/models/")} <= held
    assert {f.removeprefix("slamkit/") for f in sources() if f.startswith("slamkit/models/")} <= held
    assert {"LICENSE", "CITATION.cff", "setup.cfg", "pyproject.toml", "tests/conftest.py"} <= held
    assert "typings/filterpy/kalman/__init__.pyi" in held
    assert not [n for n in held if "__pycache__" in n]


def test_installed_wheel_imports_away_from_the_checkout(installed: Path) -> None:
    code = """
import importlib, json, pkgutil
import slamkit, slamkit.models
names = [m.name for m in pkgutil.walk_packages(slamkit.__path__, "slamkit.")]
for name in names:
    importlib.import_module(name)
import importlib.metadata as metadata
print(json.dumps([slamkit.__file__, slamkit.models.__file__, metadata.version("slamkit"), slamkit.__version__, names]))
"""
    said = run(executable(installed, "python"), "-c", code, cwd=installed)
    top, models, declared, own, names = json.loads(said)
    assert Path(top).is_relative_to(installed) and Path(models).parent == Path(top).parent / "models"
    assert declared == own
    assert {"slamkit.models.unicycle", "slamkit.models.range_bearing", "slamkit.filters.ekf"} <= set(names)


def test_installed_command_answers(installed: Path) -> None:
    said = run(executable(installed, "slamkit"), "--help", cwd=installed, NO_COLOR="1", COLUMNS="100")
    assert "Usage: slamkit" in said
    assert {"demo", "run", "simulate"} <= set(re.findall(r"\w+", said))


def test_installed_command_runs_a_filter_and_draws(installed: Path, tmp_path: Path) -> None:
    command = executable(installed, "slamkit")
    run(command, "simulate", "standing", "--out", "log", "--quiet", cwd=tmp_path)
    said = run(command, "run", "csv", "log", "--out", "out", "--json", "-", "--quiet", cwd=tmp_path, MPLBACKEND="Agg")
    assert json.loads(said)["steps"] == 300
    assert list((tmp_path / "out").glob("*.png"))


def test_a_part_of_the_suite_passes_on_the_wheel(installed: Path, tmp_path: Path) -> None:
    """The wheel does not find the checkout. (The test above runs compiled code.)"""
    for name in ("conftest.py", "models/model_examples.py", *WHEEL_TESTS):
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / "tests" / name, tmp_path / "tests" / name)
    shutil.copy2(ROOT / "pyproject.toml", tmp_path)
    at_work = "import slamkit, sys, pytest; print(slamkit.__file__); sys.exit(pytest.main(sys.argv[1:]))"
    tests = [f"tests/{name}" for name in WHEEL_TESTS]
    said = run(executable(installed, "python"), "-c", at_work, "-q", "-p", "no:cacheprovider", *tests, cwd=tmp_path)
    assert Path(said.splitlines()[0]).is_relative_to(installed)
    assert re.search(r"\d\d passed", said)


def test_importing_slamkit_is_cheap() -> None:
    code = "import sys, slamkit; print(*{'matplotlib', 'numba', 'pandas', 'dask'} & set(sys.modules))"
    assert run(sys.executable, "-c", code, cwd=ROOT).split() == []


def test_a_checkout_without_symbolic_links_says_so(tmp_path: Path) -> None:
    """On Windows git may write the link slamkit/models as a text file."""
    shutil.copytree(ROOT / "slamkit", tmp_path / "slamkit", ignore=lambda *_: ["models", "__pycache__"])
    (tmp_path / "slamkit" / "models").write_text("../models", encoding="utf-8")
    # Without site-packages, so that no installed slamkit fills in for the missing package.
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import slamkit"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=False)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: slamkit/models is not a link to the folder models")
    assert "core.symlinks" in last
    assert "ModuleNotFoundError" not in done.stderr


def test_every_third_party_import_is_declared() -> None:
    parser = ConfigParser()
    parser.read(ROOT / "setup.cfg", encoding="utf-8")
    lines = parser["options"]["install_requires"] + "\n".join(parser["options.extras_require"].values())
    required = [Requirement(line) for line in lines.splitlines() if line]
    declared = {canonicalize_name(r.name) for r in required}
    declared |= {canonicalize_name(extra) for r in required for extra in r.extras}
    distributions = packages_distributions()
    missing = set()
    for name in sources():
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse((ROOT / name).read_text(encoding="utf-8"))):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                modules = [node.module or ""]
            for top in {m.partition(".")[0] for m in modules} - sys.stdlib_module_names - {"slamkit"}:
                if not declared & {canonicalize_name(d) for d in distributions.get(top, [top])}:
                    missing.add(f"{name} imports {top}")
    assert not missing


def test_citation_names_this_version() -> None:
    import slamkit

    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", text, re.MULTILINE) == [slamkit.__version__]
