"""The files of a Python FMU: a component's own source and the instance, as a package whose name no other FMU has.

All FMUs of a process share one interpreter, so no module has a fixed import name. The entry module is named after
its content, and it loads the package beside it under a name made from the bytes of that package. Different FMUs,
different versions of an FMU and FMUs edited by hand then run side by side, each with its own code.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from pathlib import Path

from ...errors import CosimError
from ...model import Component
from ..source_files import component_origin, imported_modules, needed_files, relative_imports

PACKAGE = "motion_cosim"
PROXY = Path(__file__).with_name("proxy.c")
BINARIES = {"linux64": "libpythonfmu-export.so", "win64": "pythonfmu-export.dll"}
"""Platform folder -> PythonFMU's library, for the platforms it supports."""
DECLARATION = (
    "errors.py",
    "model.py",
    *(f"export/{name}.py" for name in ("contract", "interface")),
    *(f"export/python/{name}.py" for name in ("dual", "integrator", "memory", "messages", "python_instance", "ticks")),
)
PYTHONFMU = ("_version.py", "default_experiment.py", "enums.py", "fmi2slave.py", "logmsg.py", "variables.py")

_ENTRY = '''\
"""Where PythonFMU enters {name}. The equations are in {package}/{path}, and may be edited there."""

import ctypes
import hashlib
import importlib.util
import sys
from pathlib import Path

if sys.version_info < (3, 11):
    raise ImportError("{name} needs Python 3.11 or later, this is " + sys.version.split()[0])


def load(resources):
    """The package {package} of a resources folder, under a name made from its content."""
    folder = Path(resources) / "{package}"
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(file.relative_to(folder).as_posix().encode() + b"\\0" + file.read_bytes() + b"\\0")
    name = "{package}_" + digest.hexdigest()[:24]
    if name not in sys.modules:
        place = [str(folder)]
        spec = importlib.util.spec_from_file_location(name, folder / "__init__.py", submodule_search_locations=place)
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            for known in [known for known in sys.modules if known == name or known.startswith(name + ".")]:
                del sys.modules[known]
            raise
    return sys.modules[name]


if locals() is globals():
    package = load(Path(__file__).parent)
else:
    # PythonFMU 0.7 runs this file once more for each instance to find the class, and then drops a reference to these
    # globals that it does not own: freed memory in use, sooner or later.
    package = globals()["package"]
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}(package.Instance):
    """The instance, from the files of the FMU that is being instantiated."""

    def __new__(cls, **arguments):
        folder = arguments["resources"]
        sys.path[:] = [entry for entry in sys.path if entry != folder]
        own = load(folder)
        return object.__new__(cls) if own is package else own.Instance(**arguments)
'''

_INIT = '''\
"""The component {name} as an FMU instance."""

from .cosim.export.python.python_instance import Instance as _Instance
from .{module} import {name}
from .pythonfmu.fmi2slave import Fmi2Slave


class Instance(_Instance, Fmi2Slave):
    """An instance of {name}."""

    kind = {name}
'''

_DEPENDENCIES = """\
External dependencies of {name} (FMI 2.0.4, section 2.2)

Python: 3.11 or later, 64 bit.
  In an importer that is a Python process, that Python is used.
  In other importers the FMU loads the library of a Python itself, once in a process: the file that the environment
  variable COSIM_LIBPYTHON names, else the newest libpython3.x (on Windows python3.dll) that the system finds.
Python packages: {packages}.
PythonFMU: its library and the files it needs are in the FMU.
"""


class EmbedError(CosimError):
    """A component's files cannot be put into a Python FMU."""


def pythonfmu() -> Path:
    """The folder of PythonFMU. Raises EmbedError if it is not installed."""
    spec = importlib.util.find_spec("pythonfmu")
    if spec is None or spec.origin is None:
        raise EmbedError("the Python flavour needs PythonFMU. Install it with 'pip install pythonfmu'.")
    return Path(spec.origin).parent


def library(platform: str) -> bytes:
    """PythonFMU's library for a platform. Raises EmbedError where it has none."""
    if platform not in BINARIES:
        raise EmbedError(
            f"PythonFMU has no library for {platform}, only for {', '.join(BINARIES)}. Build the native flavour."
        )
    return (pythonfmu() / "resources" / "binaries" / platform / BINARIES[platform]).read_bytes()


def external_dependencies(kind: type[Component]) -> str:
    """documentation/externalDependencies.txt of FMI 2.0.4: what the machine that runs the FMU must have."""
    where = component_origin(kind)
    local = needed_files(where, Path(inspect.getfile(kind)))
    used = {name.partition(".")[0] for module, path in local.items() for name in imported_modules(path, module)}
    known = {"cosim", "__future__", *(module.partition(".")[0] for module in local), *sys.stdlib_module_names}
    packages = sorted(name for name in used - known if name)
    return _DEPENDENCIES.format(
        name=kind.__name__,
        packages=", ".join(packages) + ", importable in that Python" if packages else "none",
    )


def resources(kind: type[Component]) -> dict[str, bytes]:
    """The content of resources/ without guid.txt: entry module and package.

    Raises DescriptionError for an import that cannot be made relative, EmbedError without PythonFMU.
    """
    where, name = component_origin(kind), kind.__name__
    module = where.module
    own = Path(__file__).parents[2]
    files = {"__init__.py": _INIT.format(name=name, module=module).encode()}
    for path in DECLARATION:
        files[f"cosim/{path}"] = (own / path).read_bytes()
    local = needed_files(where, Path(inspect.getfile(kind)))
    for known, path in local.items():
        ending = "/__init__.py" if path.name == "__init__.py" else ".py"
        files[known.replace(".", "/") + ending] = relative_imports(path, known, local).encode()
    for path in PYTHONFMU:
        files[f"pythonfmu/{path}"] = (pythonfmu() / path).read_bytes()
    for folder in {parent.as_posix() for path in files for parent in Path(path).parents} - {"."}:
        files.setdefault(f"{folder}/__init__.py", b"")
    entry = _ENTRY.format(name=name, package=PACKAGE, path=module.replace(".", "/") + ".py")
    digest = hashlib.sha256(entry.encode())
    for path in sorted(files):
        digest.update(path.encode() + b"\0" + files[path] + b"\0")
    script = f"{PACKAGE}_{name}_{digest.hexdigest()[:16]}"
    return {
        "slavemodule.txt": script.encode(),
        f"{script}.py": entry.encode(),
        **{f"{PACKAGE}/{path}": content for path, content in files.items()},
    }
