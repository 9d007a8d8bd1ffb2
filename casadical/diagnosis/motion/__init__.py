"""Diagnosis of joint logs: causes of the torques and position errors that an arm's model leaves."""
