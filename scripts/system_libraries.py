"""Find, and where possible install, what Python packages need from the system.

The Open3D and PyMeshLab wheels link against shared libraries that a bare Linux
installation does not have, and a Debian `python3` comes without the module that
creates virtual environments. `make` runs this file before there is an environment,
so it uses the standard library only.

Whether a library is there is decided by loading it, the same way the wheels will:
package databases say what was installed, not what the loader finds.

Missing packages are installed with apt-get when that needs no password (root, or sudo
that asks nothing); otherwise the exact command is printed. Systems other than Linux are
left alone: their wheels bring what they need.

With `--browser` it looks for Chromium instead, with which the tests drive the editor's page. These
tests are skipped without one, so that its absence is told, and is no failure.

Exit status: 0 nothing is missing (any more); 1 something is, and the command or the list
of libraries was printed.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Requirement:
    """One thing the system must provide: `what` to probe for, and the Debian package."""

    what: str
    package: str
    needed_by: str


LIBRARIES = (
    Requirement("libusb-1.0.so.0", "libusb-1.0-0", "Open3D"),
    Requirement("libEGL.so.1", "libegl1", "Open3D"),
    Requirement("libGL.so.1", "libgl1", "Open3D, PyMeshLab"),
    Requirement("libX11.so.6", "libx11-6", "Open3D, PyMeshLab"),
    Requirement("libOpenGL.so.0", "libopengl0", "PyMeshLab"),
)

BROWSER = Requirement("chromium", "chromium", "the tests of the editor's page")

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""Commands of browsers that the tests can drive, the same ones that they look for."""

# Debian splits the standard library: `python3 -m venv` needs ensurepip, which comes in a
# package named after the interpreter's version.
VENV = Requirement(
    "ensurepip",
    f"python{sys.version_info.major}.{sys.version_info.minor}-venv",
    "python -m venv",
)


@dataclass(frozen=True)
class Privileges:
    """What this process may do about missing packages."""

    apt_get: bool
    root: bool
    sudo_without_password: bool


def library_loads(soname: str) -> bool:
    """Whether the dynamic loader finds `soname` and everything it depends on."""
    try:
        ctypes.CDLL(soname)
    except OSError:
        return False
    return True


def module_exists(name: str) -> bool:
    """Whether this interpreter could import `name`."""
    return importlib.util.find_spec(name) is not None


def find_missing(
    library_loads: Callable[[str], bool], module_exists: Callable[[str], bool]
) -> list[Requirement]:
    """The requirements that are not met, as the two probes see it."""
    missing = [need for need in LIBRARIES if not library_loads(need.what)]
    return missing if module_exists(VENV.what) else [*missing, VENV]


def browser_exists() -> bool:
    """Whether there is a browser that the tests can drive."""
    return any(shutil.which(name) is not None for name in BROWSERS)


def packages_of(missing: Iterable[Requirement]) -> list[str]:
    """The Debian packages that provide `missing`, each once, in order."""
    return list(dict.fromkeys(need.package for need in missing))


def install_commands(packages: Sequence[str], *, root: bool) -> list[list[str]]:
    """The commands that install `packages`, in order, with sudo unless `root`."""
    prefix = [] if root else ["sudo"]
    # sudo drops the caller's environment, so the variable is set behind it.
    quiet = [*prefix, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]
    install = [*quiet, "install", "-y", "--no-install-recommends", *packages]
    return [[*quiet, "update"], install]


def current_privileges() -> Privileges:
    """Probe this process: is it root, is there apt-get, does sudo ask for a password?"""
    sudo = shutil.which("sudo")
    return Privileges(
        apt_get=shutil.which("apt-get") is not None,
        root=os.geteuid() == 0,
        sudo_without_password=sudo is not None
        and subprocess.run([sudo, "-n", "true"], capture_output=True).returncode == 0,
    )


def provide(
    missing: Sequence[Requirement],
    privileges: Privileges,
    run: Callable[[list[str]], int],
    say: Callable[[str], None],
) -> bool:
    """Install what is `missing` if `privileges` allow it, else explain how.

    Returns whether every command ran and succeeded; the caller probes again, because a
    package that installs is not yet a library that loads.
    """
    packages = packages_of(missing)
    say("Missing from this system:")
    for need in missing:
        say(f"  {need.what} (needed by {need.needed_by}; Debian package {need.package})")
    if not privileges.apt_get:
        say("There is no apt-get here: install these with your system's package manager,")
        say("then run make again.")
        return False
    commands = install_commands(packages, root=privileges.root)
    if not (privileges.root or privileges.sudo_without_password):
        say("Installing them needs a password. Run this, then make again:")
        say("  " + " && ".join(shlex.join(command) for command in commands))
        return False
    for command in commands:
        say("+ " + shlex.join(command))
        status = run(command)
        if status != 0:
            say(f"That command failed with status {status}. Mend it, then run make again.")
            return False
    return True


def main() -> int:
    """Check, install or explain; the exit status is described in the module's docstring."""
    if not sys.platform.startswith("linux"):
        return 0
    missing = find_missing(library_loads, module_exists)
    if not missing:
        return 0
    if not provide(missing, current_privileges(), subprocess.call, _say):
        return 1
    # The directory listing that found no ensurepip is cached by the import system.
    importlib.invalidate_caches()
    still_missing = find_missing(library_loads, module_exists)
    for need in still_missing:
        _say(f"{need.package} is installed, but {need.what} still cannot be loaded.")
    return 1 if still_missing else 0


def provide_browser() -> int:
    """Install Chromium if that is possible, else tell; always 0."""
    if sys.platform.startswith("linux") and not browser_exists():
        provide([BROWSER], current_privileges(), subprocess.call, _say)
        if not browser_exists():
            _say("Without a browser, the tests of the editor's page are skipped.")
    return 0


def _say(line: str) -> None:
    sys.stderr.write(line + "\n")


if __name__ == "__main__":
    sys.exit(provide_browser() if sys.argv[1:] == ["--browser"] else main())
