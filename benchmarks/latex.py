"""Equations of the docstrings, which are plain text, as LaTeX for the pages."""

import re
import unicodedata

ACCENTS = {
    "\u0302": r"\hat",
    "\u0304": r"\bar",
    "\u0305": r"\bar",
    "\u0306": r"\breve",
    "\u0307": r"\dot",
    "\u0308": r"\ddot",
    "\u0332": r"\underline",
    "\u20db": r"\dddot",
    "\u0303": r"\tilde",
}
GREEK = {
    "α": "alpha",
    "β": "beta",
    "γ": "gamma",
    "δ": "delta",
    "ε": "varepsilon",
    "ζ": "zeta",
    "η": "eta",
    "θ": "theta",
    "κ": "kappa",
    "λ": "lambda",
    "μ": "mu",
    "ξ": "xi",
    "π": "pi",
    "ρ": "rho",
    "ϱ": "varrho",
    "ϖ": "varpi",
    "σ": "sigma",
    "ς": "varsigma",
    "τ": "tau",
    "φ": "varphi",
    "χ": "chi",
    "ψ": "psi",
    "ω": "omega",
    "Γ": "Gamma",
    "Δ": "Delta",
    "Θ": "Theta",
    "Λ": "Lambda",
    "Ξ": "Xi",
    "Σ": "Sigma",
    "Υ": "Upsilon",
    "Φ": "Phi",
    "Ψ": "Psi",
    "Ω": "Omega",
}
RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺⁽⁾ᵀᵈᴸᵏʲⁿᵖᵗ", "0123456789-+()TdLkjnpt", strict=True)) | {"⁄": "/"}
LOWERED = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₋ᵣᵢⱼₖₘₙ", "0123456789+-rijkmn", strict=True))
SIGNS = {
    "≤": r"\le ",
    "≥": r"\ge ",
    "≠": r"\ne ",
    "≈": r"\approx ",
    "·": r"\cdot ",
    "×": r"\times ",
    "→": r"\to ",
    "−": "-",
    "±": r"\pm ",
    "∞": r"\infty ",
    "∂": r"\partial ",
    "∈": r"\in ",
    "∫": r"\int ",
    "√": r"\sqrt",
    "‖": r"\|",
    "½": r"\tfrac12 ",
    "¼": r"\tfrac14 ",
    "ℓ": r"\ell ",
    "…": r"\dots ",
    "%": r"\%",
    "{": r"\{",
    "}": r"\}",
}
FUNCTIONS = {"sin", "cos", "tan", "arctan", "exp", "log", "max", "min", "det", "sup", "inf"}
OPERATORS = {"sgn", "sig", "diag", "cov", "tanh", "trace", "blockdiag"}
WORDS = r"if|otherwise|for|from|to|over|with|on|the|all|and|or|where|at|of|projected|every|which|unknown"
PHRASE = rf"(?:(?:{WORDS})|(?<=  )[a-z]{{3,}})\b(?: (?!{'|'.join(sorted(FUNCTIONS | OPERATORS))})[a-z]{{2,}}\b)*"
"""Plain words within an equation; other runs of letters are parameters or products of symbols."""
MAX_WIDTH = 100
"""Characters of a line of plain text that fit on a page."""


def to_latex(text: str) -> str:
    """Return an equation of one or more lines as display mathematics.

    The lines are aligned at their first equals sign.
    """
    lines = [part.strip() for line in text.splitlines() for part in statements(line.strip()) if part.strip()]
    if len(lines) == 1:
        return f"$$\n{line_to_latex(lines[0])}\n$$"
    body = " \\\\\n".join(aligned(line) for line in lines)
    return f"$$\n\\begin{{aligned}}\n{body}\n\\end{{aligned}}\n$$"


def statements(line: str) -> list[str]:
    """Return the statements of a line that is too wide for a page, otherwise the line."""
    parts = re.split(r"(?<=[,;]) {4,}(?!otherwise|if)", line)
    return parts if len(line) > MAX_WIDTH and all(re.search("[=≤]", part) for part in parts) else [line]


def aligned(line: str) -> str:
    """Return one line with its mark of alignment before the first relation outside brackets."""
    depth = 0
    for place, character in enumerate(line):
        depth += (character in "([{") - (character in ")]}")
        if character in "=≤≥<" and depth == 0:
            return f"{line_to_latex(line[:place].rstrip())} &{line_to_latex(line[place:])}"
    return f"&{line_to_latex(line)}"


def line_to_latex(line: str) -> str:
    """Return one line of plain mathematics as LaTeX, without delimiters."""
    parts = re.split(r"(\[[^\[\]]*;[^\[\]]*\])", unicodedata.normalize("NFD", line))
    return " ".join(_matrix(part) if number % 2 else _Reader(part).everything() for number, part in enumerate(parts))


class _Reader:
    """Reads a line of plain mathematics from left to right."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.position = 0

    def match(self, pattern: str) -> re.Match[str] | None:
        """Consume what a pattern matches at the present position."""
        match = re.compile(pattern).match(self.line, self.position)
        if match:
            self.position = match.end()
        return match

    def everything(self) -> str:
        """Return the rest of the line as LaTeX."""
        parts = []
        while self.position < len(self.line):
            parts.append(self.piece())
        return re.sub(r" {2,}", " ", "".join(parts)).strip()

    def piece(self) -> str:
        """Return the next symbol, name or gap."""
        if gap := self.match(r" {2,}"):
            return r" \qquad " if len(gap[0]) > 3 else r" \quad "
        if self.match(" "):
            return " "
        if words := self.match(PHRASE):
            return rf"\text{{ {words[0]} }}"
        if name := self.match(r"[a-z]{2,}(?:_[a-z]{2,})+"):
            return rf"\,\mathtt{{{name[0].replace('_', chr(92) + '_')}}}\,"
        if word := self.match(r"[A-Za-z]{2,}(?![\u0300-\u036f\u20db])"):
            return self.word(word[0])
        if number := self.match(r"\d+(?:\.\d+)?"):
            return number[0] + self.scripts()
        if self.match("√"):
            return rf"\sqrt{{{self.group()}}}"
        return self.symbol()

    def word(self, word: str) -> str:
        """Return a run of Latin letters: a function, plain words, a parameter, or a product of symbols."""
        if word in FUNCTIONS:
            return rf"\{word}{self.scripts()} "
        if word in OPERATORS:
            return rf"\operatorname{{{word}}}{self.scripts()} "
        if re.fullmatch(r"d[stT]", word):
            return rf"\,d{word[1]}"
        if word.islower() and len(word) > 2:
            return rf"\,\mathtt{{{word}}}\,"
        self.position -= len(word) - 1
        return word[0] + self.scripts()

    def symbol(self) -> str:
        """Return one character with its accents and scripts."""
        base, self.position = self.line[self.position], self.position + 1
        if base == "d" and re.match("[α-ω]", self.line[self.position : self.position + 1]):
            return r"\,d"
        if base == "Σ":
            return r"\sum" + self.scripts() + " "
        text = rf"\{GREEK[base]}" if base in GREEK else SIGNS.get(base, base)
        if accents := self.match(r"[\u0300-\u036f\u20db]+"):
            for accent in accents[0]:
                text = rf"{ACCENTS[accent]}{{{text}}}"
        scripts = self.scripts(subscript=base.isalpha() and base not in SIGNS)
        needs_space = re.search(r"\\[A-Za-z]+$", text) and not scripts
        return text.rstrip() + scripts if scripts else text + (" " if needs_space else "")

    def scripts(self, subscript: bool = False) -> str:
        """Return the indices, exponents and primes that follow a symbol; digits count as an index of a letter."""
        below, above, primes = [], [], ""
        while True:
            if mark := self.match(r"['′*]"):
                primes += "" if mark[0] == "*" else "'"
                above += ["*"] if mark[0] == "*" else []
            elif subscript and not below and (digits := self.match(r"\d+|(?<=ω)[no](?![a-z])")):
                below.append(digits[0])
            elif lowered := self.match(f"[{''.join(LOWERED)}]+"):
                below.append("".join(LOWERED[character] for character in lowered[0]))
            elif raised := self.match(f"[{''.join(RAISED)}]+"):
                above.append("".join(RAISED[character] for character in raised[0]))
            elif self.match("_"):
                below.append(self.group())
            elif self.match(r"\^"):
                above.append(self.group())
            else:
                break
        index = f"_{{{','.join(below)}}}" if below else ""
        exponent = f"^{{{''.join(above)}}}" if above else ""
        return index + primes + exponent.replace("T", r"\mathsf{T}")

    def group(self) -> str:
        """Return what stands in brackets, or else one number, name or symbol, without scripts of its own."""
        if bracket := self.match(r"\(([^()]*)\)|\{([^{}]*)\}"):
            return _Reader(bracket[1] or bracket[2]).everything()
        run = self.match(r"[−+-]?(?:[A-Za-z0-9]+|[α-ωΑ-Ω½ϱ∞])[\u0300-\u036f]*")
        if not run:
            raise ValueError(f"no index or exponent at {self.line[self.position :]!r}, in {self.line!r}")
        letters = re.fullmatch(r"[A-Za-z]{2,}", run[0])
        return run[0] if letters else _Reader(run[0]).everything()


def _matrix(text: str) -> str:
    """Return ``[a b; c d]`` as a matrix."""
    rows = [" & ".join(_Reader(entry).everything() for entry in row.split()) for row in text[1:-1].split(";")]
    return r"\begin{bmatrix}" + r" \\ ".join(rows) + r"\end{bmatrix}"
