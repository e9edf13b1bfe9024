"""What programs drive and judge: references, gains, controllers and robots in closed loops."""
