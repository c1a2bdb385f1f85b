# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender for the tests in this folder, each in a clean profile.

BLENDER           the program, such as /opt/blender/blender; without it these tests are skipped
BLENDER_GUI       a command that runs it in a window, such as "xvfb-run -a /opt/blender/blender"
BLENDER_EXCHANGE  where Blender runs in a root folder of its own (chroot): the folder here that it
                  sees as /exchange
"""

import os
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

EXTENSION_MODULE = "bl_ext.user_default.tactile_clay"


@dataclass(frozen=True)
class BlenderResult:
    """What a run of Blender left."""

    exit_code: int
    output: str
    """Standard output and standard error, in the order written."""


@dataclass(frozen=True)
class Blender:
    """A real Blender with a profile and a working folder that both sides can reach."""

    command: tuple[str, ...]
    """The program, without a window."""
    window_command: tuple[str, ...]
    """The program in a window; empty where there is none."""
    exchange: Path | None
    """The folder that Blender sees as /exchange, or None where both sides see the same paths."""
    profile: Path
    """What BLENDER_USER_RESOURCES points to."""
    folder: Path
    """Working folder of this test: files for Blender to read and write."""

    def path_inside(self, path: Path) -> str:
        """Return a path as Blender sees it.

        Raises:
            ValueError: Blender cannot see it; copy it below `folder` first.
        """
        if self.exchange is None:
            return str(path)
        if not path.is_relative_to(self.exchange):
            raise ValueError(f"{path} is not below {self.exchange}, which is all Blender can see")
        return f"/exchange/{path.relative_to(self.exchange)}"

    def share(self, path: Path) -> Path:
        """Return a file that Blender can see: the file itself, or a copy in `folder`."""
        if self.exchange is None or path.is_relative_to(self.exchange):
            return path
        return Path(shutil.copy2(path, self.folder / path.name))

    def run(
        self, *arguments: str | Path, window: bool = False, timeout: float = 300.0
    ) -> BlenderResult:
        """Run Blender to its end.

        Args:
            arguments: The command line; a Path is given as Blender sees it.
            window: Whether to run in a window; without one the first argument is most often "-b".
            timeout: Time after which Blender and all that it started are killed [s].

        Raises:
            TimeoutError: Blender did not end in time; the message holds what it said.
        """
        if window and not self.window_command:
            pytest.skip("no window for Blender: set BLENDER_GUI to a command that gives one")
        command = list(self.window_command if window else self.command)
        for argument in arguments:
            inside = self.path_inside(argument) if isinstance(argument, Path) else argument
            command.append(inside)
        environment = {key: value for key, value in os.environ.items() if "PYTHON" not in key}
        # Blender ignores a folder that is not there where it finds a profile in the home folder.
        self.profile.mkdir(parents=True, exist_ok=True)
        environment["BLENDER_USER_RESOURCES"] = self.path_inside(self.profile)
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            output, _ = process.communicate()
            raise TimeoutError(f"{shlex.join(command)}\n{output}") from None
        return BlenderResult(process.returncode, output)

    def run_script(
        self,
        source: str,
        *arguments: str | Path,
        scene: Path | None = None,
        window: bool = False,
        timeout: float = 300.0,
    ) -> BlenderResult:
        """Run Python source in Blender; an exception in it makes the exit code 9.

        Args:
            source: The script; it finds its arguments in sys.argv after "--".
            arguments: Arguments for the script; a Path is given as Blender sees it.
            scene: The .blend file to open first.
            window: Whether to run in a window, where it is the script that moves the mouse; then
                the script must end Blender itself.
            timeout: Time after which Blender is killed [s].

        Raises:
            TimeoutError: Blender did not end in time.
        """
        descriptor, name = tempfile.mkstemp(prefix="script-", suffix=".py", dir=self.folder)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(source)
        opening: list[str | Path] = ["--enable-event-simulate"] if window else ["-b"]
        if scene is not None:
            opening.append(scene)
        opening += ["--python-exit-code", "9", "--python", Path(name), "--", *arguments]
        return self.run(*opening, window=window, timeout=timeout)

    def install(self, extension_zip: Path) -> BlenderResult:
        """Install the extension from its zip into the profile and enable it."""
        return self.run(
            *("--command", "extension", "install-file", "--repo", "user_default", "--enable"),
            self.share(extension_zip),
        )

    def uninstall(self) -> BlenderResult:
        """Remove the extension from the profile."""
        return self.run("--command", "extension", "remove", "tactile_clay")


@pytest.fixture(scope="session")
def blender_base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Blender]:
    """Blender with a folder for the whole session, in which each test has its own."""
    program = os.environ.get("BLENDER")
    if not program:
        pytest.skip("no real Blender: set BLENDER to the path of one")
    if shutil.which(program) is None:
        raise FileNotFoundError(f"BLENDER={program}: there is no such program")
    exchange = os.environ.get("BLENDER_EXCHANGE")
    if exchange:
        folder = Path(tempfile.mkdtemp(prefix="tests-", dir=exchange)).resolve()
    else:
        folder = tmp_path_factory.mktemp("blender")
    yield Blender(
        command=(program,),
        window_command=tuple(shlex.split(os.environ.get("BLENDER_GUI", ""))),
        exchange=Path(exchange).resolve() if exchange else None,
        profile=folder / "profile",
        folder=folder,
    )
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def blender(blender_base: Blender) -> Iterator[Blender]:
    """Blender in a clean profile of this test alone."""
    folder = Path(tempfile.mkdtemp(prefix="test-", dir=blender_base.folder))
    yield replace(blender_base, profile=folder / "profile", folder=folder)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def extension_profile(blender_base: Blender, extension_zip: Path) -> Path:
    """A profile with the extension installed and enabled from its zip."""
    profile = blender_base.folder / "profile-with-extension"
    installed = replace(blender_base, profile=profile).install(extension_zip)
    assert installed.exit_code == 0, installed.output
    return profile


@pytest.fixture
def blender_with_extension(blender: Blender, extension_profile: Path) -> Blender:
    """Blender with the extension enabled, in a profile that tests share: leave it as it is."""
    return replace(blender, profile=extension_profile)
