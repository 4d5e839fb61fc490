"""The benchmark of `benchmarks.places.days`, whose processes need a module with a name."""

from benchmarks.places.days import main

if __name__ == "__main__":
    main()
