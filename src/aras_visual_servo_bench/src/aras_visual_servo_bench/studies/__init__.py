"""Studies: many runs of an experiment with different settings, and their results.

Modules in the order in which a study passes through them:

- settings: `study`, with what varies in `variations` and `variation_case`;
- one run: `run_rows`, and `image_table` for the data of its images;
- all runs: `study_execution`, which sends chunks of runs (`chunk_execution`) to the workers of a
  pool (`pools`, `dask_pool`) and stores their rows in a `study_folder`;
- results: `results`, shown by `tables` and `latex`, compared by `compare`, described by `captions`;
- further uses: `replay` repeats a run, `tuner` searches settings, `data_card` describes a data set,
  `remedies` applies the remedy of a failed run.

`run_study` does all this from Python, the commands in `cli` from the command line.
"""
