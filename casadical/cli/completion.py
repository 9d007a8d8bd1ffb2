"""Values of options for the shell's completion; looked up only when the shell asks."""


def _begun(words: tuple[str, ...], incomplete: str) -> list[str]:
    return [word for word in words if word.lower().startswith(incomplete.lower())]


def _listed(words: tuple[str, ...], incomplete: str) -> list[str]:
    """Completions of the last word of a list by commas."""
    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{word}" for word in _begun(words, last)]


def methods(incomplete: str) -> list[str]:
    """Words for `--method`."""
    from casadical.project.problem_file import all_methods

    return _begun(all_methods(), incomplete)


def losses(incomplete: str) -> list[str]:
    """Words for `--loss`."""
    from casadical.project.problem_file import all_losses

    return _begun(all_losses(), incomplete)


def criteria(incomplete: str) -> list[str]:
    """Words for `--criterion`."""
    from casadical.project.planning import all_criteria

    return _begun(all_criteria(), incomplete)


def languages(incomplete: str) -> list[str]:
    """Words for `export c --language`; after a comma, of the next one."""
    from casadical.export.c.registry import known_languages

    return _listed(tuple(known_languages()), incomplete)


def forms(incomplete: str) -> list[str]:
    """Words for `export model --to`."""
    from casadical.export.model_file import FORMS

    return _begun(FORMS, incomplete)


def effects(incomplete: str) -> list[str]:
    """Names of effects; after a comma, of the next one."""
    from casadical.project.diagnosis import all_effects

    return _listed(all_effects(), incomplete)
