"""Things that programs drive and judge: sources, references, gains, controllers, and robots in open and closed loops."""
