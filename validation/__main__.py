"""`python -m validation` is the command `ssmr`: without a program it lists them all."""

from validation.cli.__main__ import main

main()
