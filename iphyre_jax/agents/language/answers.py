"""Where the answers of a run come from: a model, with a transcript that grows, or a transcript alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from iphyre_jax.agents.language import transcripts
from iphyre_jax.agents.language.calls import Answer, CallSettings
from iphyre_jax.agents.language.prompts import Message
from iphyre_jax.agents.language.settings import Caps, RunSettings, parameters
from iphyre_jax.agents.language.transcripts import Entry, Question
from iphyre_jax.checks import show
from iphyre_jax.scenes import Scene

Complete = Callable[[Sequence[Message], CallSettings], Answer]


class Live:
    """Answers from a transcript first, then from a model, whose answers it appends there.

    Args:
        complete: asks the model.
        file: the transcript.
        model: kind and name of the model.
        settings: of the run.
        caps: of the run.
        say: told of every call.

    Raises:
        ValueError: the transcript is damaged, another model's, or of other parameters; one line.
    """

    def __init__(
        self,
        complete: Complete,
        file: Path,
        model: Mapping[str, str],
        settings: RunSettings,
        caps: Caps,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._complete, self._file, self._settings, self._caps, self._say = complete, file, settings, caps, say
        own = parameters(settings.call)
        self._asked = {**model, "parameters": own}
        self._known = transcripts.read(file) if file.is_file() else {}
        for question, entry in self._known.items():
            if entry.model != model["model"] or entry.kind != model["kind"]:
                raise ValueError(f"{file}: {question}: expected answers of {model['model']}, got {show(entry.model)}")
            if entry.parameters != own:
                got = show(str(dict(entry.parameters)))
                raise ValueError(f"{file}: {question}: expected answers with {own}, got {got}")
        self._questions = len(self._known)
        self._tokens = sum(_tokens(entry.answer) for entry in self._known.values())

    def __call__(self, question: Question, scene: Scene, conversation: Sequence[Message]) -> Answer:
        """Answer a question.

        Raises:
            CallFailedError: the model gave no answer.
            ValueError: a cap is reached, or the transcript holds an answer to another question; one line.
        """
        prompt = self._settings.asked
        if (entry := self._known.get(question)) is not None:
            return transcripts.matching(entry, question, scene, prompt, conversation)
        if self._questions >= self._caps.questions or self._tokens >= self._caps.tokens:
            raise ValueError(
                f"llm: {question}: the run has reached its cap of {self._caps.questions} questions or "
                f"{self._caps.tokens} tokens ({self._questions} and {self._tokens}); give more to go on"
            )
        answer = self._complete(conversation, self._settings.call)
        transcripts.append(self._file, transcripts.line_of(question, scene, prompt, self._asked, conversation, answer))
        self._questions += 1
        self._tokens += _tokens(answer)
        self._say(f"{question}: {answer.seconds:.1f} s, {_tokens(answer)} tokens")
        return answer


class Replay:
    """Answers from a transcript alone.

    Args:
        file: the transcript.
        settings: of the run.
    """

    def __init__(self, file: Path, settings: RunSettings) -> None:
        self._file, self._known, self._prompt = file, transcripts.read(file), settings.asked

    @property
    def models(self) -> list[str]:
        """Kinds and names of the models that answered."""
        return sorted({f"{entry.kind}: {entry.model}" for entry in self._known.values()})

    @property
    def parameters(self) -> list[Mapping[str, Any]]:
        """What the lines say of their calls, each once."""
        found: list[Mapping[str, Any]] = []
        for entry in self._known.values():
            if entry.parameters not in found:
                found.append(entry.parameters)
        return found

    @property
    def handwritten(self) -> bool:
        """Whether any line was written by a person."""
        return any(entry.kind == transcripts.HANDWRITTEN for entry in self._known.values())

    def __call__(self, question: Question, scene: Scene, conversation: Sequence[Message]) -> Answer:
        """Answer a question.

        Raises:
            ValueError: it is missing in the transcript, or another one was asked there; one line that names it.
        """
        entry: Entry | None = self._known.get(question)
        if entry is None:
            raise ValueError(f"replay: {self._file.name}: expected an answer to {question}, got none")
        return transcripts.matching(entry, question, scene, self._prompt, conversation)


def _tokens(answer: Answer) -> int:
    return (answer.tokens_in or 0) + (answer.tokens_out or 0)
