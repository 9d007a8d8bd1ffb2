"""Values of options for the shell's completion; looked up only when the shell asks."""

from collections.abc import Callable, Iterable
from importlib import import_module


def _offered(module: str, name: str, *, listed: bool = False) -> Callable[[str], list[str]]:
    """The words that a function or a constant of a module has; listed : by commas, of which the last is completed."""

    def complete(incomplete: str) -> list[str]:
        known = getattr(import_module(f"casadical.{module}"), name)
        words: Iterable[str] = known() if callable(known) else known
        before, comma, last = incomplete.rpartition(",") if listed else ("", "", incomplete)
        return [f"{before}{comma}{word}" for word in words if word.lower().startswith(last.lower())]

    return complete


methods = _offered("project.problem_file", "all_methods")  # --method
losses = _offered("project.problem_file", "all_losses")  # --loss
criteria = _offered("project.planning", "all_criteria")  # --criterion
languages = _offered("export.c.registry", "known_languages", listed=True)  # export c --language
forms = _offered("export.model_file", "FORMS")  # export model --to
effects = _offered("project.diagnosis", "all_effects", listed=True)  # --effects
