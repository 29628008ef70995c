"""The public surface: a name that comes, goes or changes is seen here."""

from pathlib import Path

from meta.test_promises import public_objects

LIST = Path(__file__).with_name("public_names.txt")


def test_public_names_are_those_of_the_list():
    names = sorted(name for name, _ in public_objects())
    listed = LIST.read_text(encoding="utf-8").split()
    added = sorted(set(names) - set(listed))
    removed = sorted(set(listed) - set(names))
    assert not added, f"new public names: document them, add them to {LIST.name} and mention them in the changelog"
    assert not removed, f"public names that are gone: take them out of {LIST.name} and mention them in the changelog"
    assert listed == sorted(set(listed))
