"""The correction of joint commands: its C export, and corrected offline programs."""
