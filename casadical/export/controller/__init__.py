"""The correction of joint commands: what the C export is made of, and corrected offline programs."""
