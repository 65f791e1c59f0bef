"""Where the reference results inside the FMUs come from: experiments, exact traces, pictures, icons.

``make.write`` writes them into ``fmus/references/NAME``; from there ``cosim.export`` puts them into FMUs.
"""
