"""What is said where a file cannot be written."""

import pytest

from tarc.core.errors import InvalidParameter
from tarc.core.files import file_in_folder, make_folder, writing


def test_a_full_disk_is_named_with_the_file(tmp_path):
    message = r"save: cannot write .*a\.txt: No space left on device; free space or choose another path"
    with pytest.raises(InvalidParameter, match=message), writing("save", tmp_path / "a.txt"):
        raise OSError(28, "No space left on device")


def test_a_folder_below_a_file_cannot_be_made(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(InvalidParameter, match=r"--out: cannot write .*taken/here"):
        make_folder("--out", tmp_path / "taken" / "here")
    assert make_folder("--out", tmp_path / "new" / "one").is_dir()


def test_the_folder_of_a_file_must_exist(tmp_path):
    with pytest.raises(InvalidParameter, match=r"save: got '.*nodir/x.nc'; the folder .*nodir does not exist"):
        file_in_folder("save", tmp_path / "nodir" / "x.nc")
    assert file_in_folder("save", tmp_path / "x.nc") == tmp_path / "x.nc"
