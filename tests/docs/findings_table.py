"""What findings about recordings mean, in Markdown."""

from __future__ import annotations

from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS


def findings() -> str:
    """Return a section for each code."""
    parts = [
        f"### {each.title}\n\n`{code}`\n\n- **For a study:** {each.means}\n"
        f"- **To do:** {each.to_do}\n"
        for code, each in EXPLANATIONS.items()
    ]
    return "\n" + "\n".join(parts) + "\n"
