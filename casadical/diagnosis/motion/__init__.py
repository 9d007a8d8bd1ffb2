"""The diagnosis of joint logs: which cause lies behind torques and position errors that an arm's model leaves."""
