"""./pave over stand-ins for apt, pip, CMake and Ninja: what it runs, in which order, what it says, and when it runs nothing.

SPDX-License-Identifier: BSD-3-Clause

The stand-ins write their command lines into calls.txt. The real set-up is what `./pave test` itself has just been through.
"""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from command import ROOT

COPIED = ("pave", "packages.txt", "requirements.lock", "requirements-test.lock", "CMakeLists.txt")
FOLDERS = ("cmake", "kernels", "host", "staging", "python", "examples", "tests")

LOG = 'echo "$(basename "$0") $*" >>"$CALLS"\n'
TOOLS = {
    "dpkg-query": 'for name in "${@:3}"; do grep -qx "$name" "$MISSING" || echo "installed $name"; done\n',
    "apt-get": LOG + 'test -z "${APT_SAYS:-}" || { echo "$APT_SAYS"; exit 100; }\n: >"$MISSING"\n',
    "sudo": LOG + '[ "$1" = -v ] || exec "$@"\n',
    "id": 'echo "${USER_ID:-0}"\n',
    "git": "cat head.txt 2>/dev/null || echo commit-1\n",
    "cmake": LOG + 'mkdir -p "$4"; touch "$4/build.ninja"\n',
    "ninja": LOG + 'sleep "${BUILD_TAKES:-0}"\ntest -z "${BUILD_SAYS:-}" || { echo "$BUILD_SAYS"; exit 1; }\n'
    'touch "$(dirname "$2")/python/pave/_pave.fake.so"\n',
    "python3": 'if [ "$1" = -m ] && [ "$2" = venv ]; then\n' + LOG + '  mkdir -p "$4/bin"\n'
    '  cp "$TOOLS/venv-python" "$4/bin/python"\nfi\n',
    "venv-python": 'case "$1 $2" in\n'
    '"-m pip")\n' + LOG + '  test -z "${PIP_SAYS:-}" || { echo "$PIP_SAYS"; exit 1; } ;;\n'
    '"-c "*) echo "$TREE/site-packages" ;;\n'
    '*) echo "ran: $*" ;;\nesac\n',
}  # fmt: skip


class Tree:
    """A clone of the parts that ./pave looks at, with stand-ins for its tools."""

    def __init__(self, folder, name="clone"):
        self.root = folder / name
        self.root.mkdir()
        for name in COPIED:
            shutil.copy2(ROOT / name, self.root / name)
        for name in FOLDERS:
            (self.root / name).mkdir()
            (self.root / name / "source.cpp").write_text("int a;\n")
        (self.root / "python" / "pave").mkdir()
        (self.root / "site-packages").mkdir()
        tools = folder / "tools"
        tools.mkdir()
        for name, text in TOOLS.items():
            (tools / name).write_text("#!/bin/bash\n" + text)
            (tools / name).chmod(0o755)
        self.calls_file = folder / "calls.txt"
        self.missing = folder / "missing.txt"
        self.missing.write_text("g++\ncmake\n")
        self.environment = {
            "PATH": f"{tools}:/usr/bin:/bin",
            "CALLS": str(self.calls_file),
            "MISSING": str(self.missing),
            "TOOLS": str(tools),
            "TREE": str(self.root),
            "PAVE_PYTHON": str(tools / "python3"),
            "HOME": str(folder),
        }

    def start(self, *arguments, **changes):
        return subprocess.Popen(
            [str(self.root / "pave"), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**self.environment, **changes},
            cwd=self.root,
        )

    def run(self, *arguments, **changes):
        """(exit code, stdout, lines of stderr)."""
        process = self.start(*arguments, **changes)
        out, err = process.communicate(timeout=60)
        return process.returncode, out, err.splitlines()

    def calls(self):
        """What was run since the last call, without this folder's name."""
        if not self.calls_file.exists():
            return []
        text = self.calls_file.read_text().replace(str(self.root), ".")
        self.calls_file.unlink()
        return text.splitlines()


@pytest.fixture
def tree(tmp_path):
    return Tree(tmp_path)


@pytest.fixture
def ready(tree):
    """The same after a first call."""
    code, _, err = tree.run("devices")
    assert code == 0, err
    tree.calls()
    time.sleep(0.02)  # so that what changes now is newer than the build, whatever the clock's grain
    return tree


def test_first_call_sets_up_in_order_and_runs_the_command(tree):
    code, out, err = tree.run("devices", "--json")
    assert code == 0, err
    assert out == "ran: -I -m pave devices --json\n"
    assert "        cmake g++" in [line.rstrip() for line in err]
    assert err[0] == "pave: Debian packages to install, with what they depend on:"
    calls = tree.calls()
    assert calls[0].startswith("apt-get") and calls[0].endswith(" update")  # noqa: PT018
    assert calls[1].endswith("install -y --no-install-recommends cmake g++")
    assert calls[2].startswith("python3 -m venv")
    assert "install torch==" in calls[3]
    assert calls[4].endswith("install -r ./requirements.lock")
    assert calls[5].startswith("cmake -S . -B ./build -G Ninja")
    assert calls[6] == "ninja -C ./build _pave"
    assert len(calls) == 7
    assert (tree.root / "site-packages" / "pave.pth").read_text() == f"{tree.root}/python\n"


def test_a_folder_with_spaces_in_its_name(tmp_path):
    tree = Tree(tmp_path, "a clone  of mine")
    code, out, err = tree.run("devices")
    assert code == 0, err
    assert out == "ran: -I -m pave devices\n"
    calls = tree.calls()
    assert calls[4].endswith("install -r ./requirements.lock")
    assert calls[5].startswith("cmake -S . -B ./build -G Ninja")
    assert tree.run("devices") == (0, out, [])
    assert tree.calls() == []
    code, out, err = tree.run("test", "--fast")
    assert code == 0, err
    assert out == f"ran: {tree.root}/tests/run.py --fast\n"
    assert tree.calls()[1].endswith("install -r ./requirements.lock -r ./requirements-test.lock")


def test_python_files_of_the_current_folder_are_not_imported(ready):
    """The command's Python is started in isolated mode, whatever lies where the user is."""
    real = ready.root / ".venv" / "bin" / "python"
    real.write_text(f'#!/bin/bash\nexec {sys.executable} "$@"\n')
    (ready.root / "typer.py").write_text("raise SystemExit('typer.py of the current folder')\n")
    (ready.root / "pave.py").write_text("raise SystemExit('pave.py of the current folder')\n")
    _, _, err = ready.run("devices")
    assert not [line for line in err if "current folder" in line], err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("waiting", [False, True])
def test_interrupted_set_up_ends_with_one_line_and_goes_on(tree, number, waiting):
    first = tree.start("devices", BUILD_TAKES="5")
    wait_for(lambda: tree.calls_file.exists() and "ninja" in tree.calls_file.read_text())
    process = tree.start("devices") if waiting else first
    if waiting:
        process.stderr.readline()  # that it waits for the other
    begin = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 4.0
    assert (process.returncode, out) == (1, ""), err
    assert err.splitlines()[-1].startswith("pave: error: interrupted"), err
    assert err.count("pave: error: ") == 1
    first.communicate(timeout=60)
    code, out, err = tree.run("devices")
    assert code == 0, err
    assert out == "ran: -I -m pave devices\n"


def wait_for(condition, limit_s=30):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_second_call_runs_nothing_and_is_quick(ready):
    begin = time.monotonic()
    code, out, err = ready.run("devices")
    seconds = time.monotonic() - begin
    assert (code, out, err) == (0, "ran: -I -m pave devices\n", [])
    assert ready.calls() == []
    assert seconds < 2.0  # 0.07 s on an idle machine


def test_tests_add_their_packages_and_targets(ready):
    code, out, err = ready.run("test", "--fast")
    assert code == 0, err
    assert out.startswith("ran: ")
    assert out.endswith("/tests/run.py --fast\n")
    calls = ready.calls()
    assert calls[1].endswith("install -r ./requirements.lock -r ./requirements-test.lock")
    assert "-DPAVE_TESTS=ON" in calls[2]
    assert calls[3] == "ninja -C ./build all"
    ready.run("devices")
    assert ready.calls() == []  # a test set-up serves every command


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("host/source.cpp", ["ninja"]),
        ("host/new.cpp", ["ninja"]),
        ("kernels/new.h", ["ninja"]),
        ("python/source.cpp", ["ninja"]),
        ("head.txt", ["ninja"]),
        ("requirements.lock", ["python", "python"]),
        ("tests/source.cpp", []),
        ("python/pave/new.py", []),
        ("README.md", []),
    ],
)
def test_a_change_redoes_what_depends_on_it(ready, name, expected):
    with open(ready.root / name, "a") as file:
        file.write("# changed\n")
    code, _, err = ready.run("devices")
    assert code == 0, err
    assert [line.split()[0] for line in ready.calls()] == expected
    ready.run("devices")
    assert ready.calls() == []


def test_a_removed_source_is_noticed(ready):
    (ready.root / "host" / "source.cpp").unlink()
    ready.run("devices")
    assert ready.calls() == ["ninja -C ./build _pave"]


def test_two_at_once_set_up_once(tree):
    both = [tree.start("devices", BUILD_TAKES="1.5") for _ in range(2)]
    for process in both:
        out, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
        assert out == "ran: -I -m pave devices\n"
    calls = tree.calls()
    assert len([call for call in calls if call.startswith("ninja")]) == 1
    assert len([call for call in calls if " venv " in call]) == 1


def failing(tree, *parts, **changes):
    """One line of error with `parts` in it, code 1, and the same command works once the cause is gone."""
    code, out, err = tree.run("devices", **changes)
    assert code == 1, err
    assert out == ""
    errors = [line for line in err if line.startswith("pave: error: ")]
    assert len(errors) == 1, err
    assert err[-1] == errors[0]
    for part in parts:
        assert part in errors[0], errors[0]
    code, out, err = tree.run("devices")
    assert code == 0, err
    assert out == "ran: -I -m pave devices\n"


def test_no_network(tree):
    text = "W: Failed to fetch: Temporary failure resolving 'mirror'"
    failing(tree, "network cannot be reached", APT_SAYS=text)


def test_no_network_for_pip(tree):
    text = "Failed to establish a new connection: [Errno -3]"
    failing(tree, "torch failed", "network cannot be reached", PIP_SAYS=text)


def test_full_disk(tree):
    text = "ERROR: Could not install packages: [Errno 28] No space left on device"
    failing(tree, "disk is full", "make room", PIP_SAYS=text)


def test_another_distribution(tree):
    failing(tree, "no Debian 12", APT_SAYS="E: Unable to locate package libfoo")


def test_a_build_that_fails_names_the_error_and_the_log(tree):
    text = "trace.cpp:7:1: error: expected ';' before '}' token"
    failing(tree, "build failed", text, "setup.log", BUILD_SAYS=text)


def test_user_without_sudo(tree):
    (tree.root.parent / "tools" / "sudo").unlink()
    tree.environment["PATH"] = f"{tree.root.parent / 'tools'}:{bare_path(tree)}"
    code, _, err = tree.run("devices", USER_ID="1000")
    assert code == 1
    assert err[-1].startswith("pave: error: needs root and there is no sudo")
    assert "apt-get install cmake g++" in err[-1]
    assert tree.calls() == []


def bare_path(tree):
    """A folder with the system's small tools, but no sudo."""
    folder = tree.root.parent / "bin"
    folder.mkdir()
    for name in os.listdir("/usr/bin"):
        if name != "sudo":
            (folder / name).symlink_to(f"/usr/bin/{name}")
    return folder


def test_user_with_sudo(tree):
    code, _, err = tree.run("devices", USER_ID="1000")
    assert code == 0, err
    calls = tree.calls()
    assert calls[0] == "sudo -v"
    assert calls[1].startswith("sudo env DEBIAN_FRONTEND=noninteractive apt-get")


def test_system_packages_can_be_left_alone(tree):
    code, _, err = tree.run("devices", PAVE_NO_APT="1")
    assert code == 0, err
    assert not [call for call in tree.calls() if "apt-get" in call]


def test_a_system_without_debian_packages_is_told_what_to_install(tree):
    (tree.root.parent / "tools" / "dpkg-query").unlink()
    folder = bare_path(tree)
    (folder / "dpkg-query").unlink()
    tree.environment["PATH"] = f"{tree.root.parent / 'tools'}:{folder}"
    code, _, err = tree.run("devices")
    assert code == 1
    assert len(err) == 1
    assert "by hand" in err[0]
    assert "pocl-opencl-icd" in err[0]


def test_old_python(tree):
    (tree.root.parent / "tools" / "python3").write_text("#!/bin/bash\nexit 1\n")
    code, _, err = tree.run("devices")
    assert code == 1
    assert "older than 3.10" in err[-1]
