"""`pip install .` makes a package that works by itself: module, library, scenes and the command.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGES = Path(sysconfig.get_path("purelib"))


def run(*command, **options):
    """Output of a command; a failure shows all of it."""
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=1200, **options
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Python of a fresh environment with the wheel, and this environment's packages behind it.

    Its libraries come from here, so that nothing is downloaded; PAVE and ADIOS2, which belong side by side, do not.
    """
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    # The option's long form: pip 23.0, which Debian 12's venv has, knows no other. A build folder of its own leaves the
    # clone as it is; ccache, if there, spares it most of what the clone's own build has compiled.
    run(
        *pip, "wheel", "--no-build-isolation", "--no-deps", "-w", folder, ROOT,
        "--config-settings", f"build-dir={folder / 'build'}",
        env={**os.environ, "CMAKE_BUILD_PARALLEL_LEVEL": str(os.cpu_count() or 1)},
    )  # fmt: skip
    (wheel,) = folder.glob("pave-*.whl")
    run(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    purelib = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    run(python, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", wheel)
    (purelib / "adios2").symlink_to(PACKAGES / "adios2")
    # A plain line of a .pth file adds the folder, but not what that folder's own .pth files say.
    (purelib / "zz-behind.pth").write_text(f"{PACKAGES}\n")
    return python, wheel


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_wheel_works_by_itself(installed, tmp_path):
    python, wheel = installed
    names = zipfile.ZipFile(wheel).namelist()
    assert sum(name.startswith("pave/_pave.") and name.endswith(".so") for name in names) == 1
    assert {"pave/_pave.pyi", "pave/py.typed", "pave/templates/report.html.j2"} <= set(names)
    assert sum(name.startswith("pave/libpave.so") for name in names) == 1
    assert "pave/scenes/cornell.xml" in names
    assert not [name for name in names if name.endswith((".cpp", ".h", ".a", ".cmake"))]

    where = run(
        python, "-c", "import pave; print(pave.__file__); print(pave.__version__)", cwd=tmp_path
    )
    path, version = where.split()
    assert Path(path).is_relative_to(python.parent.parent)
    assert version == "0.1.0"

    libraries = run("ldd", Path(path).parent / "libpave.so")
    assert "not found" not in libraries
    assert str(PACKAGES) not in libraries.replace(str(PACKAGES / "adios2"), "")

    command = python.parent / "pave"
    out = run(
        command, "render", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "2", "--json",
        cwd=tmp_path, env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )  # fmt: skip
    assert json.loads(out)["size"] == [16, 16]
    assert (tmp_path / "x.exr").stat().st_size > 1000
