"""The figures of a study, one file a figure family: arrays and tables in, matplotlib figures out."""
