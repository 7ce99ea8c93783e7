"""A rendered trial, shipped for `bendtrack demo`. Files only; `README.md` says what they are."""
