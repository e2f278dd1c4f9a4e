"""The decisions of scripts/system_libraries.py, with faked probes and commands."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "system_libraries.py"
spec = importlib.util.spec_from_file_location("system_libraries", SCRIPT)
assert spec is not None
assert spec.loader is not None
system = importlib.util.module_from_spec(spec)
sys.modules["system_libraries"] = system  # dataclasses look their module up
spec.loader.exec_module(system)

ROOT = system.Privileges(apt_get=True, root=True, sudo_without_password=False)
SUDO = system.Privileges(apt_get=True, root=False, sudo_without_password=True)
USER = system.Privileges(apt_get=True, root=False, sudo_without_password=False)
NO_APT = system.Privileges(apt_get=False, root=True, sudo_without_password=True)


class Machine:
    """A fake system: which sonames load, which commands ran, what was said."""

    def __init__(self, absent: set[str], status: int = 0, installs: bool = True) -> None:
        self.absent = set(absent)
        self.status = status
        self.installs = installs
        self.commands: list[list[str]] = []
        self.said: list[str] = []

    def loads(self, name: str) -> bool:
        return name not in self.absent

    def run(self, command: list[str]) -> int:
        self.commands.append(command)
        if self.installs and "install" in command and self.status == 0:
            self.absent.clear()
        return self.status

    def missing(self) -> list:
        return system.find_missing(self.loads, self.loads)

    def provide(self, privileges) -> bool:
        return system.provide(self.missing(), privileges, self.run, self.said.append)

    def main(self, monkeypatch, privileges, platform: str = "linux") -> int:
        monkeypatch.setattr(system, "library_loads", self.loads)
        monkeypatch.setattr(system, "module_exists", self.loads)
        monkeypatch.setattr(system, "current_privileges", lambda: privileges)
        monkeypatch.setattr(system.subprocess, "call", self.run)
        monkeypatch.setattr(system, "_say", self.said.append)
        monkeypatch.setattr(system.sys, "platform", platform)
        return system.main()


EVERYTHING = {need.what for need in system.LIBRARIES} | {"ensurepip"}


def test_a_complete_system_is_left_alone(monkeypatch):
    machine = Machine(absent=set())
    assert machine.main(monkeypatch, ROOT) == 0
    assert machine.commands == []
    assert machine.said == []


@pytest.mark.parametrize("what", sorted(EVERYTHING))
def test_each_missing_thing_is_found_and_named(what):
    machine = Machine(absent={what})
    (need,) = machine.missing()
    assert need.what == what
    assert not machine.provide(USER)
    assert any(what in line and need.package in line for line in machine.said)


def test_root_updates_then_installs_without_questions(monkeypatch):
    machine = Machine(absent={"libusb-1.0.so.0", "libGL.so.1"})
    assert machine.main(monkeypatch, ROOT) == 0
    update, install = machine.commands
    assert update == ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "update"]
    assert install[:4] == ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "install"]
    assert "-y" in install
    assert install[-2:] == ["libusb-1.0-0", "libgl1"]


def test_sudo_that_asks_nothing_is_used(monkeypatch):
    machine = Machine(absent={"ensurepip"})
    assert machine.main(monkeypatch, SUDO) == 0
    assert all(command[0] == "sudo" for command in machine.commands)
    major, minor = sys.version_info[:2]
    assert machine.commands[-1][-1] == f"python{major}.{minor}-venv"


def test_a_user_is_told_the_exact_command_and_nothing_runs(monkeypatch):
    machine = Machine(absent=EVERYTHING)
    assert machine.main(monkeypatch, USER) == 1
    assert machine.commands == []
    command = machine.said[-1]
    assert "sudo env DEBIAN_FRONTEND=noninteractive apt-get update && sudo" in command
    assert all(package in command for package in system.packages_of(machine.missing()))


def test_without_apt_the_libraries_are_listed_and_nothing_runs(monkeypatch):
    machine = Machine(absent={"libEGL.so.1"})
    assert machine.main(monkeypatch, NO_APT) == 1
    assert machine.commands == []
    assert any("libEGL.so.1" in line for line in machine.said)
    assert any("package manager" in line for line in machine.said)


def test_a_command_that_fails_stops_the_rest_and_says_so(monkeypatch):
    machine = Machine(absent={"libGL.so.1"}, status=100)
    assert machine.main(monkeypatch, ROOT) == 1
    assert len(machine.commands) == 1
    assert "status 100" in machine.said[-1]


def test_an_installation_that_does_not_help_is_not_called_good(monkeypatch):
    machine = Machine(absent={"libGL.so.1"}, installs=False)
    assert machine.main(monkeypatch, ROOT) == 1
    assert "still cannot be loaded" in machine.said[-1]


def test_other_systems_are_left_alone(monkeypatch):
    machine = Machine(absent=EVERYTHING)
    assert machine.main(monkeypatch, USER, platform="darwin") == 0
    assert machine.said == []


def test_one_package_for_two_libraries_is_asked_for_once():
    twice = [system.Requirement(name, "libgl1", "a viewer") for name in ("a", "b")]
    assert system.packages_of(twice) == ["libgl1"]


@pytest.mark.parametrize(("privileges", "installs"), [(ROOT, True), (USER, True), (ROOT, False)])
def test_a_browser_is_installed_where_that_is_possible_and_missed_otherwise(
    monkeypatch, privileges, installs
):
    machine = Machine(absent={"chromium"}, installs=installs)
    monkeypatch.setattr(system, "browser_exists", lambda: machine.loads("chromium"))
    monkeypatch.setattr(system, "current_privileges", lambda: privileges)
    monkeypatch.setattr(system.subprocess, "call", machine.run)
    monkeypatch.setattr(system, "_say", machine.said.append)
    monkeypatch.setattr(system.sys, "platform", "linux")
    assert system.provide_browser() == 0
    assert bool(machine.commands) == privileges.root
    found = machine.loads("chromium")
    assert found == (privileges.root and installs)
    assert ("skipped" in machine.said[-1]) != found
    said = len(machine.said)
    if found:
        assert system.provide_browser() == 0
        assert len(machine.said) == said


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="probes the ELF loader")
def test_the_real_probe_tells_present_from_absent():
    assert system.library_loads("libc.so.6")
    assert not system.library_loads("libthis-does-not-exist.so.9")
    assert system.module_exists("json")
    assert not system.module_exists("this_does_not_exist")
