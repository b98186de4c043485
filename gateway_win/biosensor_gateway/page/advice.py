"""Words advice for people who click, where a sentence names a command or its option."""

from __future__ import annotations

import re

# What a sentence says of commands, and what the page has for it.
_ON_THE_PAGE = tuple(
    (re.compile(pattern), words)
    for pattern, words in (
        (
            r"(;|, or) choose another place with --output",
            r"\1 write another folder under *Save to this folder*",
        ),
        (r"; (name another|give another name) with --output", "; move or rename that file first"),
        (
            r"[Rr]un `xdf salvage --header-from` with another recording of the same streams",
            "Name another recording of the streams under *Headers from*, and click *Salvage it*",
        ),
        (r"[Rr]un `xdf salvage`", "Click *Salvage it*"),
        (r"`xdf salvage`|xdf salvage(?= gives)", "*Salvage it*"),
        (r"try biosensor-gateway xdf salvage \S.*", "choose it here and click *Salvage it*"),
        (r"check it with: biosensor-gateway xdf check .*", "choose it here and click *Check it*"),
        (
            r"confirm that with --whose sensors, or use the name's with --whose name",
            "choose under *Participant* which is right",
        ),
        (r"until --whose says which is right", "until *Participant* says which is right"),
        (
            r"export with `--whose sensors` or `--whose name`",
            "choose under *Participant* of *Export* which is right",
        ),
        (
            r"--rate HZ helps if you know it",
            "if you know it, the command `biosensor-gateway xdf export` takes it (--rate)",
        ),
        (r"export with `--rate`", "the command `biosensor-gateway xdf export` takes it (`--rate`)"),
        (r"; --streams .* plays it alone", ""),
        (
            r"export it with another --session or --task, or alone",
            "export it alone, to another folder",
        ),
        (r"with `record stop` or LabRecorder's \*Stop\*", "with *Stop*"),
        (
            r"; start an agent with: biosensor-gateway run",
            "; click *Start streaming* or *Find sensors* first",
        ),
        (
            r"Wait for (that|them) with: .* using --allow-missing",
            r'Wait for \1, or tick "even if streams are missing"',
        ),
        (r"find out why with: biosensor-gateway doctor", "find out why by *Check this computer*"),
        (r"; start with: biosensor-gateway record start", "; click *Record*"),
        (r"; end it first: biosensor-gateway record stop", "; click *Stop recording* first"),
        (r"; record stop --file checks it again", "; check it under *Recordings* later"),
        (r"Check it with: biosensor-gateway xdf check\.", "Check it under *Recordings*."),
        (r"`doctor` command", "computer check (`doctor`)"),
    )
)


def clicked(text: str) -> str:
    """Return a sentence in which advice is about what the page has."""
    for pattern, words in _ON_THE_PAGE:
        text = pattern.sub(words, text)
    return text
