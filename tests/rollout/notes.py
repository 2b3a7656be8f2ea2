"""What tests of trainings listen with."""


class Notes:
    """A listener that collects the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def episode(self, row: dict) -> None:
        pass

    def validation(self, row: dict) -> None:
        pass

    def note(self, text: str) -> None:
        self.notes.append(text)

    def close(self) -> None:
        pass
