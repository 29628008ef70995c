"""Types and defaults of parameters, from the signature alone."""

from typing import Any

from griffe import (
    Docstring,
    DocstringSectionParameters,
    Extension,
    GriffeError,
    Module,
    Object,
)


class SignatureTypes(Extension):
    """Give each parameter of a shared entry its own type and default.

    The parser gives all of them those of the first.
    """

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """Visit all objects of a package, once it is loaded."""
        self.visit(pkg)

    def visit(self, found: Object) -> None:
        """Correct an object's docstring and those of its members."""
        if found.docstring:
            found.docstring.__class__ = SignedDocstring
        for member in found.members.values():
            if not member.is_alias:
                self.visit(member)


class SignedDocstring(Docstring):
    """A docstring whose parameters know their signature."""

    def parse(self, *args: Any, **options: Any) -> Any:
        """Sections, as the parser makes them, with the parameters corrected."""
        sections = super().parse(*args, **options)
        for section in sections:
            if isinstance(section, DocstringSectionParameters):
                for parameter in section.value:
                    self.correct(parameter)
        return sections

    def correct(self, parameter: Any) -> None:
        """Type and default of one parameter, if the signature has it."""
        try:
            signed = self.parent.parameters[parameter.name]
        except (AttributeError, KeyError, GriffeError):
            return
        parameter.annotation, parameter.value = (
            signed.annotation,
            signed.default,
        )
