"""FMUs in your own tool
=====================

Trial.
"""

# %%
# A helper: commands of a terminal in a temporary folder, which is gone when this script ends.
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

temporary = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
FOLDER = Path(temporary.name)  # or Path("my_folder"), if you want to keep the files


def run(command):
    """Run a command as in a terminal, and print what it says."""
    print("$", command)
    called = [sys.executable, "-m", *shlex.split(command)]
    ended = subprocess.run(called, cwd=FOLDER, capture_output=True, check=False, text=True)
    print(ended.stdout + ended.stderr)
    ended.check_returncode()


def show(name, title):
    """A picture that a command wrote."""
    return SimpleNamespace(_repr_png_=(FOLDER / name).read_bytes, title=title)


# %%
# The commands
run("cosim run shams2010/fsmc_5sin --stop-time 1 --set trajectory.amplitude=0.01 --plot run.png")
run("cosim fmus copy fmus BallscrewStage")
run("cosim info fmus/BallscrewStage.fmu")

# %%
show("run.png", "Loop of the stage")

# %%
import cosim

result = cosim.simulate(cosim.read_system("shams2010/fsmc_5sin"))
result

# %%
result.plot()

# %%
import matplotlib.pyplot as plt

plt.plot([1, 2])
plt.title("Hello you")
plt.show()
