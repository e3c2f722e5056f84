"""Moving the arm by hand: keyboard, gamepad, single steps."""
