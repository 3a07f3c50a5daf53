"""Undo and redo: steps back and forth, what belongs to one step, and what is no step at all."""

from workbench.session.history import History


def test_undo_goes_back_and_redo_forth_with_the_labels_of_the_changes():
    history = History("a", longest=10)
    history.change("b", "to b")
    history.change("c", "to c")
    assert (history.present, history.undo_label, history.redo_label) == ("c", "to c", None)
    assert history.undo() == "to c"
    assert (history.present, history.undo_label, history.redo_label) == ("b", "to b", "to c")
    assert history.redo() == "to c"
    assert history.present == "c"
    assert history.redo() is None


def test_without_a_change_there_is_nothing_to_take_back():
    history = History("a", longest=10)
    assert not history.change("a", "nothing")
    assert history.undo() is None
    assert history.present == "a"


def test_a_change_after_undo_ends_what_could_be_made_again():
    history = History("a", longest=10)
    history.change("b", "to b")
    history.undo()
    assert history.change("c", "to c")
    assert history.redo() is None
    assert history.present == "c"


def test_a_drag_back_to_where_it_began_is_no_step():
    history = History(0, longest=10)
    history.change(1, "before")
    for value in (2, 3, 1):
        history.change(value, "slider", gesture="slider")
    assert [step.label for step in history.steps] == ["before"]
    history.change(5, "slider", gesture="slider")
    assert [step.state for step in history.steps] == [0, 1]


def test_a_drag_is_one_step_until_it_is_taken_back():
    history = History(0, longest=10)
    for value in (1, 2, 3):
        history.change(value, "slider", gesture="slider")
    history.undo()
    assert history.present == 0
    history.change(4, "slider", gesture="slider")
    assert history.undo() == "slider"
    assert history.present == 0


def test_only_the_last_steps_can_be_taken_back():
    history = History(0, longest=3)
    for value in range(1, 6):
        history.change(value, str(value))
    taken = [history.undo() for _ in range(4)]
    assert taken == ["5", "4", "3", None]
    assert history.present == 2


def test_what_undo_would_bring_back_can_be_looked_at():
    history = History("a", longest=10)
    assert history.previous is None
    history.change("b", "to b")
    assert (history.previous, history.present) == ("a", "b")
