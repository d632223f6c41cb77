"""The tables of README.md and docs/, made from the result files in benchmarks/results.

    python -m benchmarks.tables            # or: make tables
    python -m benchmarks.tables --check    # fails where a document says something else

A table stands in a document between `<!-- table NAME -->` and `<!-- end NAME -->`. What stands
between them is written by the function of that name in `catalogue.TABLES`, and nothing else says a
measured number.
"""
