"""Plain-text equations become LaTeX."""

import pytest
from benchmarks.latex import line_to_latex, to_latex


@pytest.mark.parametrize(
    ("plain", "latex"),
    [
        ("K1 = ωn²", r"K_{1} = \omega_{n}^{2}"),
        ("q̈ᵈ − K2 (v̂ − q̇ᵈ)", r"\ddot{q}^{d} - K_{2} (\hat{v} - \dot{q}^{d})"),
        ("AᵀP + PA = −Q", r"A^{\mathsf{T}}P + PA = -Q"),
        ("P = [P1 P2ᵀ; P2 P3]", r"P = \begin{bmatrix}P_{1} & P_{2}^{\mathsf{T}} \\ P_{2} & P_{3}\end{bmatrix}"),
        ("−ϱ s / max(‖s‖, ε)", r"-\varrho s / \max (\|s\|, \varepsilon )"),
        ("k2 |s|^½ sgn s", r"k_{2} |s|^{\tfrac12} \operatorname{sgn} s"),
        (
            "0  if ‖s_h‖ > γ,     1  otherwise",
            r"0 \quad \text{ if } \|s_{h}\| > \gamma , \qquad 1 \quad \text{ otherwise }",
        ),
        ("T rise_rate ‖s‖", r"T \,\mathtt{rise\_rate}\, \|s\|"),
        ("∫₀ᴸ √L dσ", r"\int_{0}^{L} \sqrt{L} \,d\sigma"),
    ],
)
def test_line(plain, latex):
    assert line_to_latex(plain).split() == latex.split()


def test_lines_are_aligned_at_the_first_relation():
    assert to_latex("s(x=0) = 1\na ≤ b\n") == ("$$\n\\begin{aligned}\ns(x=0) &= 1 \\\\\na &\\le b\n\\end{aligned}\n$$")


def test_an_index_without_a_symbol_is_refused():
    with pytest.raises(ValueError, match="no index or exponent"):
        line_to_latex("x_ ")
