import os
import signal
import subprocess
import sys

import pytest

SITE = """\
import os, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            os.kill(os.getpid(), signal.SIGINT)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell starts what it runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupt())
"""


def interrupted(tmp_path, module: str, *command: str) -> subprocess.CompletedProcess:
    """Run a command that is interrupted when it imports a certain module."""
    (tmp_path / "sitecustomize.py").write_text(SITE)
    path = os.pathsep.join([str(tmp_path), os.getcwd(), os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"PYTHONPATH": path, "INTERRUPT_AT": module}
    return subprocess.run([sys.executable, *command], capture_output=True, text=True, env=env)


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent by a signal of POSIX")
@pytest.mark.parametrize("module", ["numpy", "gymnasium", "pettingzoo", "twc_env.running.command_line"])
def test_ctrl_c_during_import_prints_one_line(tmp_path, module):
    done = interrupted(tmp_path, module, "-m", "twc_env", "--help")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


SCRIPT = "import sys\nfrom twc_env.__main__ import main\nsys.exit(main())\n"
"""What pip writes as the command `twc-env`."""


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent by a signal of POSIX")
@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("gymnasium", "--help"),
        ("argcomplete", "--help"),
        ("twc_env.running.command_line", "--help"),
        ("twc_env.commands.maps", "maps list"),
        ("numba", "maps list"),
    ],
)
def test_ctrl_c_while_the_installed_command_imports_prints_one_line(tmp_path, module, arguments):
    (tmp_path / "twc-env").write_text(SCRIPT)
    done = interrupted(tmp_path, module, str(tmp_path / "twc-env"), *arguments.split())
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent by a signal of POSIX")
def test_a_worker_process_of_the_installed_command_raises_the_interrupt(tmp_path):
    (tmp_path / "twc-env").write_text(
        "import multiprocessing\nfrom twc_env.__main__ import main\nif __name__ == '__main__':\n    import work\n"
        "    worker = multiprocessing.get_context('spawn').Process(target=work.do)\n"
        "    worker.start()\n    worker.join()\n"
    )
    (tmp_path / "work.py").write_text(
        "def do():\n    try:\n        import colorsys\n    except KeyboardInterrupt:\n        print('tidied up')\n"
    )
    done = interrupted(tmp_path, "colorsys", str(tmp_path / "twc-env"))
    assert (done.stdout, done.stderr) == ("tidied up\n", "")


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent by a signal of POSIX")
def test_other_programs_get_a_keyboard_interrupt(tmp_path):
    (tmp_path / "stranger").mkdir()
    (tmp_path / "stranger" / "__init__.py").write_text("import twc_env\n")
    program = "import twc_env\ntry:\n    import colorsys\nexcept KeyboardInterrupt:\n    print('tidied up')\n"
    (tmp_path / "stranger" / "__main__.py").write_text(program)
    for command in (("-m", "stranger"), ("-c", program)):
        done = interrupted(tmp_path, "colorsys", *command)
        assert (done.returncode, done.stdout, done.stderr) == (0, "tidied up\n", "")


@pytest.mark.skipif(os.name != "posix", reason="SIGTERM is of POSIX")
def test_a_signal_that_compiled_code_turns_into_a_system_error_is_an_interruption():
    code = (
        "import os, signal, sys\nfrom twc_env.running.command_line import exit_status\n"
        "def work(signals):\n    try:\n        for number in signals:\n            os.kill(os.getpid(), number)\n"
        "    except KeyboardInterrupt as error:\n        raise SystemError('an exception set') from error\n"
        "    raise SystemError('a fault')\n"
        "print(exit_status(lambda: work([signal.SIGTERM])))\ntry:\n    exit_status(lambda: work([]))\n"
        "except SystemError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("143\na fault\n", "interrupted\n")


LOST = {
    "a callback from C": "ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.{0}))()",
    "a finaliser": "Final()",
}
"""Where Python prints an exception and goes on."""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("where", LOST)
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_an_interrupt_that_python_drops_comes_again(where, name, status):
    program = (
        "import ctypes, os, signal, sys, time\nfrom twc_env.running.command_line import exit_status\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Final:\n    def __del__(self):\n        os.kill(os.getpid(), signal.{0})\n"
        f"def command():\n    {LOST[where]}\n    time.sleep(60)\nsys.exit(exit_status(command))"
    )
    call = [sys.executable, "-c", program.replace("{0}", name)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=50)  # not only when the sleep is over
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "interrupted\n")


def after_a_lost_signal(name: str, then: str, again_s: float = 0.02, before: str = "") -> subprocess.CompletedProcess:
    """Run a command that loses a signal, which comes once more after so long, and then does something else."""
    program = (
        f"import ctypes, os, signal, sys, threading, time\n{before}\nfrom twc_env.running import command_start\n"
        "from twc_env.running.command_line import exit_status\n"
        f"signal.signal(signal.SIGINT, signal.default_int_handler)\ncommand_start._AGAIN_S = {again_s}\n"
        f"def command():\n    {LOST['a callback from C'].replace('{0}', name)}\n    {then}\n"
        "print(exit_status(command), flush=True)\ntime.sleep(1.0)\nprint('more work')"
    )
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=50)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_that_was_dropped_does_not_come_after_the_command(name):
    done = after_a_lost_signal(name, "return 0")
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\nmore work\n", "")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_that_comes_once_more_late_does_not_end_what_another_one_lets_save():
    """The thread that raises it may have to wait for compiled code."""
    later = (
        "try:\n        os.kill(os.getpid(), signal.SIGINT)\n        time.sleep(5)\n    except KeyboardInterrupt:\n"
        "        command_start._received[0] = (2, 0.0)\n        time.sleep(1.0)\n        print('saved')\n    return 130"
    )
    done = after_a_lost_signal("SIGINT", later, again_s=0.5)
    assert (done.returncode, done.stdout, done.stderr) == (0, "saved\n130\nmore work\n", "")


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_an_interrupt_comes_until_it_is_received():
    """A signal that comes just before a wait begins does not end it."""
    then = (
        "send, sent = signal.pthread_kill, []\n    def late(*call):\n        sent.append(call)\n"
        "        len(sent) > 1 and send(*call)\n    signal.pthread_kill = late\n    time.sleep(10)"
    )
    done = after_a_lost_signal("SIGINT", then, again_s=0.5)
    assert (done.returncode, done.stdout, done.stderr) == (0, "130\nmore work\n", "interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_an_error_that_comes_of_a_dropped_interrupt_is_an_interruption(name, status):
    """Numba's compiler, interrupted in a callback of LLVM, goes on without a result."""
    done = after_a_lost_signal(name, "raise RuntimeError('no compiled object yet')", again_s=0.3)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{status}\nmore work\n", "interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_is_not_lost_while_python_tells_of_the_one_it_dropped():
    slow = (  # as on a machine that other programs keep busy
        "start = threading.Thread.start\ndef slow(thread):\n    start(thread)\n    time.sleep(0.5)\n"
        "threading.Thread.start = slow"
    )
    done = after_a_lost_signal("SIGTERM", "time.sleep(10)", before=slow)
    assert (done.returncode, done.stdout, done.stderr) == (0, "143\nmore work\n", "interrupted\n")


def test_other_exceptions_that_python_drops_are_told_as_ever(monkeypatch):
    from twc_env.running.command_line import exit_status

    class Final:
        def __del__(self):
            raise ZeroDivisionError("planted")

    def command():
        Final()

    told = []
    monkeypatch.setattr(sys, "unraisablehook", hook := lambda lost: told.append(str(lost.exc_value)))
    assert exit_status(command) == 0
    assert told == ["planted"] and sys.unraisablehook is hook
