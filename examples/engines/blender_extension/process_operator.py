"""What the operators that run `hir` share: Blender stays usable while the process runs."""

import bpy

from .hir_process import HirError, HirProcess
from .preferences import hir_program

TIMER_SECONDS = 0.5


class HirProcessOperator:
    """Base of an operator that runs `hir` once. `finish` is called when the command has succeeded.

    Without windows (`blender --background`, the module bpy) there are no timers: the operator waits.
    """

    _process = None
    _timer = None

    def finish(self, context):
        """Uses the result; raises `HirError`."""
        raise NotImplementedError

    def discard(self):
        """Removes temporary files."""

    def run_hir(self, context, arguments, run):
        """Starts the process; returns what `execute` of the operator returns."""
        try:
            self._process = HirProcess(hir_program(context), arguments, run)
        except HirError as error:
            return self.fail(error)
        if bpy.app.background:
            self._process.wait()
            return self._conclude(context)
        self._timer = context.window_manager.event_timer_add(TIMER_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self._process.stop()  # hir ends its step first; the timer sees when
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._process.is_running:
            context.workspace.status_text_set(f"hir: {self._process.progress()}    Esc: cancel")
            return {"PASS_THROUGH"}
        self._remove_timer(context)
        return self._conclude(context)

    def cancel(self, context):
        """Blender calls this when the window is closed or another file is opened."""
        self._remove_timer(context)
        self._process.end()
        self.discard()

    def fail(self, error):
        """Reports an error; returns what the operator returns then."""
        self.discard()
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def _conclude(self, context):
        process, self._process = self._process, None
        try:
            if process.was_stopped:
                self.discard()
                self.report({"WARNING"}, "hir was cancelled")
                return {"CANCELLED"}
            if not process.has_succeeded:
                return self.fail(process.sentence())
        finally:
            process.end()
        try:
            self.finish(context)
        except HirError as error:
            return self.fail(error)
        self.discard()
        return {"FINISHED"}

    def _remove_timer(self, context):
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            context.workspace.status_text_set(None)
            self._timer = None
