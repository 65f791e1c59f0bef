"""The results of runs: the Result, figures of merit, comparisons, pictures, reports."""
