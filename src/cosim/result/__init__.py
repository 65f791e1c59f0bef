"""What came out of a run: the Result, figures of merit, pictures."""
