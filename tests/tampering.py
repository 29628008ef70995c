"""Certificates written and read again, as they are and with one entry changed."""

from typing import Any

import numpy as np

from tarc.certificates import Certificate
from tarc.certificates.encoding import to_plain
from tarc.stored_certificates import certificate_from_dict, certificate_from_json


def reread(certificate: Certificate) -> Certificate:
    """Write a certificate as JSON and read it."""
    return certificate_from_json(certificate.to_json())


def _parent(content: Any, path: str) -> tuple[Any, Any]:
    """Return the container of the entry at a path such as ``loops.0.A``, and the entry's key in it."""
    *names, last = path.split(".")
    for name in names:
        content = content[int(name) if isinstance(content, list) else name]
    return content, int(last) if isinstance(content, list) else last


def rewritten(certificate: Certificate, path: str, value: Any) -> Certificate:
    """Write a certificate and read it with another value at a path of what is written."""
    content = certificate.to_dict()
    parent, key = _parent(content, path)
    assert key in parent or isinstance(parent, list)
    parent[key] = value
    return certificate_from_dict(content)


def replaced(certificate: Certificate, path: str, value: Any) -> Certificate:
    """Write a certificate and read it with another value at a path of its evidence."""
    return rewritten(certificate, f"evidence.{path}", to_plain(value))


def scaled(certificate: Certificate, path: str, factor: float) -> Certificate:
    """Write a certificate and read it with the number or array at a path of its evidence multiplied."""
    parent, key = _parent(certificate.to_dict()["evidence"], path)
    return replaced(certificate, path, np.asarray(parent[key], dtype=float)[()] * factor)


def without(certificate: Certificate, path: str) -> dict[str, Any]:
    """Return what a certificate writes, less the entry at a path of its evidence."""
    content = certificate.to_dict()
    parent, key = _parent(content["evidence"], path)
    del parent[key]
    return content
