"""From a log of your machine to a plant that behaves like it: run it cell by cell, or as ``python your_machine.py``.

The log here is made up (docs/examples/your_machine/make_records.py), so the truth is known; put yours in its place.
Everything is written into the folder results/your_machine below the one in which you run it.
"""

# %% The log
# CSV with names and, if there is one, a row of units; Parquet and MAT files are read, too.
from pathlib import Path

import cosim
from cosim.design.fit import fit, sensitivities, write_start
from cosim.design.fit_report import write_page
from cosim.design.friction import identify_friction, plot_friction
from cosim.record.read import read_record

LOGS = Path(__file__).resolve().parent / "your_machine"
RESULTS = Path("results") / "your_machine"

record = read_record(LOGS / "stage.csv")
columns = ", ".join(f"{name} [{unit}]" for name, unit in record.units.items())
print(f"{len(record.time)} samples, {record.step:g} s apart: {columns}")

# %% First values, without any model of the loop
# Force at the table: 0.2 N.m/V of the drive over 10 mm a turn.
N_PER_V = 0.2 / (0.01 / 6.283185307179586)
look = identify_friction(record.path, position="position", force="command", factor=N_PER_V, force_unit="N")
for value in look.values:
    told = f"{value.value:.4g} +- {value.deviation:.2g} {value.unit}" if value.excited else "not excited"
    print(f"{value.name:25} {told:28} {value.why}")
plot_friction(look, RESULTS / "friction.png", title="First values")

# %% The log replayed: the reference that was logged drives the loop of FMUs
# [signals] in the system file names the log; see docs/examples/your_machine/stage.toml.
system = cosim.read_system(LOGS / "stage.toml")
result = cosim.simulate(system)
off = record.column("position") - result["plant.position"]
print(f"with the start values of the FMU the position is off by {1e6 * off.std():.3g} um rms")

# %% What would a fit tell? Nothing is fitted yet
before = sensitivities(LOGS / "stage_fit.toml")
for estimate in before.estimates:
    print(f"1 % of {estimate.name:16} moves the position by {1e9 * estimate.effects['position']:.3g} nm rms")

# %% The fit
fitted = fit(LOGS / "stage_fit.toml")
print(fitted.message, f"after {fitted.loops} runs of a record")
for estimate in fitted.estimates:
    print(f"{estimate.name:16} {estimate.value:.6g} in {estimate.low:.6g} ... {estimate.high:.6g} {estimate.unit}")
for sentence in fitted.findings:
    print(sentence)

# %% Does it hold on a record that was not fitted?
for compared in fitted.comparisons:
    name = f"{compared.record} {compared.output} ({'not fitted' if compared.validates else 'fitted'})"
    print(f"{name}: {compared.rms:.3g} {compared.unit} rms, fit {compared.fit:.4g} %")

# %% The plant of your machine
# start.toml goes beside stage.toml, which it completes; the page has records, residuals, spectra and correlation.
write_start(fitted, RESULTS / "start.toml", base="stage.toml")
write_page(fitted, RESULTS / "fit.html")
machine = system.changed(fitted.start_values)
off = record.column("position") - cosim.simulate(machine)["plant.position"]
print(f"with the fitted values the position is off by {1e6 * off.std():.3g} um rms, the delay of its sensor included")
