"""Programs that measured what documents and notes say: `python -m bench.experiments.NAME`."""
