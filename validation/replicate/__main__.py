"""The command line `python -m validation.replicate`."""

from validation.replicate.run import replicate

if __name__ == "__main__":
    replicate.main()
