"""Texts of parameters, as the command line shows them."""

from dataclasses import fields

from tarc.core.docstrings import parameter_texts
from tarc.design import DesignRequirements


def test_every_requirement_has_a_text():
    texts = parameter_texts(DesignRequirements)
    assert set(texts) == {field.name for field in fields(DesignRequirements)}
    assert texts["period"] == "Control period [s]."
    assert all(text.endswith(".") for text in texts.values())


def test_names_on_one_line_share_a_text_and_other_sections_are_left_out():
    def documented():
        """Return nothing.

        Parameters
        ----------
        low, high
            Ends of the range,
            both included.

        Returns
        -------
        None
            Nothing.
        """

    assert parameter_texts(documented) == {name: "Ends of the range, both included." for name in ("low", "high")}


def test_no_docstring_no_texts():
    assert parameter_texts(lambda: None) == {}
