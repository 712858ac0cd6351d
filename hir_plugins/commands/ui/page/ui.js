// The page of `hir ui`: it asks the server for its state, displays it, and sends what the user does.

import { STATES, photographs, removal, startForm } from "./capture_view.js";
import { chosen, dropped } from "./dropped_files.js";
import { bytesText, element, refresh } from "./elements.js";
import { get, post, put } from "./requests.js";
import { activity, messages, preview, results, stages } from "./run_view.js";

const SENDERS = 4;
const part = (id) => document.getElementById(id);
const isBusy = ({ state }) => ["checking", "running"].includes(state);

let selected = decodeURIComponent(location.hash.slice(1));
let checks = {}; // documents of `hir check`, by the capture's id
let announced = "";
let sending = null; // the upload in progress: { abort, id }
let timer = 0;

function announce(sentence) {
  if (sentence === announced) return;
  announced = sentence;
  part("status").textContent = sentence;
}

// Does something for the user; an error is displayed in `place`.
async function attempt(place, action) {
  part(place).textContent = "";
  try {
    await action();
  } catch (error) {
    const target = part(place) ?? part("connection");
    if (error.message !== "cancelled") target.textContent = error.message;
  }
  await update();
}

function select(id, focus = false) {
  selected = id;
  history.replaceState(null, "", `#${encodeURIComponent(id)}`);
  update().then(() => { if (focus) part("capture-title")?.focus(); });
}

// — adding captures —

async function upload(found) {
  if (sending) throw new Error("Wait until the other folder is copied.");
  const { name, files } = await found;
  const total = files.reduce((sum, { file }) => sum + file.size, 0);
  const controller = new AbortController();
  sending = { abort: () => controller.abort(), id: null };
  showUpload(name, 0, total);
  try {
    const listed = files.map(({ path, file }) => ({ path, size: file.size }));
    const { upload: id } = await post("uploads", { name, files: listed });
    sending.id = id;
    await sendFiles(id, files, controller, (sent) => showUpload(name, sent, total));
    const { capture } = await post(`uploads/${id}/finish`);
    announce(`${name} is copied`);
    select(capture, true);
  } catch (error) {
    controller.abort();
    if (sending.id) post(`uploads/${sending.id}/cancel`).catch(() => {});
    throw error;
  } finally {
    sending = null;
    part("upload").hidden = true;
  }
}

async function sendFiles(id, files, controller, onSent) {
  const sent = new Array(files.length).fill(0);
  let next = 0, sum = 0;
  const send = async () => {
    while (next < files.length) {
      if (controller.signal.aborted) throw new Error("cancelled");
      const index = next++;
      const count = (bytes) => {
        sum += bytes - sent[index];
        sent[index] = bytes;
        onSent(sum);
      };
      await put(`uploads/${id}/${index}`, files[index].file, count, controller.signal);
      count(files[index].file.size);
    }
  };
  await Promise.all(Array.from({ length: SENDERS }, send));
}

function showUpload(name, sent, total) {
  part("upload").hidden = false;
  part("upload-text").textContent = `${name}: ${bytesText(sent)} of ${bytesText(total)} copied`;
  part("upload-bar").value = total ? sent / total : 1;
}

function listenForCaptures() {
  part("choose-folder").addEventListener("click", () => part("folder-input").click());
  part("choose-files").addEventListener("click", () => part("files-input").click());
  for (const id of ["folder-input", "files-input"]) {
    part(id).addEventListener("change", () => attempt("add-error", async () => {
      const found = chosen(part(id).files);
      part(id).value = "";
      await upload(found);
    }));
  }
  part("cancel-upload").addEventListener("click", () => sending?.abort());
  part("path-form").addEventListener("submit", (event) => {
    event.preventDefault();
    attempt("add-error", async () => {
      const { capture } = await post("captures", { path: part("path").value });
      part("path").value = "";
      select(capture, true);
    });
  });
  let depth = 0; // enter and leave are sent for every element below the pointer
  const mark = (change) => {
    depth = Math.max(0, depth + change);
    document.body.classList.toggle("dragging", depth > 0);
  };
  addEventListener("dragenter", (event) => { event.preventDefault(); mark(1); });
  addEventListener("dragleave", () => mark(-1));
  addEventListener("dragover", (event) => { event.preventDefault(); event.dataTransfer.dropEffect = "copy"; });
  addEventListener("drop", (event) => {
    event.preventDefault();
    mark(-depth);
    const found = dropped(event.dataTransfer);
    attempt("add-error", () => upload(found));
  });
  addEventListener("pagehide", () => {
    if (sending?.id) fetch(`uploads/${sending.id}/cancel`, { method: "POST", body: "", keepalive: true });
  });
}

// — displaying —

const actions = {
  check: () => attempt("action-error", () => {
    delete checks[selected];
    return post(`captures/${encodeURIComponent(selected)}/check`);
  }),
  stop: () => attempt("action-error", () => post(`captures/${encodeURIComponent(selected)}/stop`)),
  start: (preset, settings, scan) => attempt("start-error", () =>
    post(`captures/${encodeURIComponent(selected)}/start`, { preset, settings, scan })),
  remove: () => attempt("remove-error", async () => {
    await post(`captures/${encodeURIComponent(selected)}/remove`);
    delete checks[selected];
    announce(`${selected} is removed`);
    selected = "";
    history.replaceState(null, "", location.pathname);
    part("path").focus();
  }),
};

function showList(captures) {
  part("empty").hidden = captures.length > 0;
  refresh(part("list"), [captures, selected], () => captures.map((capture) => element("li", {},
    element("button", {
      type: "button", id: `select-${capture.id}`, class: "entry", "aria-current": capture.id === selected ? "true" : false,
      onclick: () => select(capture.id, true),
    }, element("span", { class: "name" }, capture.name),
    element("span", { class: `badge ${capture.state}` }, STATES[capture.state])))));
}

function section(id, title) {
  return element("section", { id, "aria-labelledby": `${id}-title` },
    element("h3", { id: `${id}-title` }, title), element("div", { id: `${id}-content` }));
}

function showCapture(capture, presets) {
  const main = part("capture");
  refresh(main, capture?.id ?? null, () => {
    if (!capture) {
      return [element("div", { class: "welcome" },
        element("h2", {}, "Start with a folder of photographs"),
        element("p", {}, "Drop it on this page. hir checks the photographs, and you choose how good the result has to be."),
        element("ol", {},
          element("li", {}, "Photograph the object from all sides, with one exposure and a lit, unmoving surrounding."),
          element("li", {}, "Drop the folder. Cameras and masks in it are used; without them, they are found."),
          element("li", {}, "Start. The page shows how far it is, and offers the files at the end.")))];
    }
    return [
      element("div", { id: "capture-head" }), element("p", { id: "action-error", class: "error", role: "alert" }),
      section("result", "Result"), section("progress", "Progress"),
      section("photographs", "Photographs"), section("reconstruction", "Reconstruction"),
      element("div", { id: "removal" }),
    ];
  });
  if (!capture) return;
  refresh(part("capture-head"), [capture.name, capture.state, capture.source], () => [
    element("h2", { id: "capture-title", tabindex: "-1" }, capture.name, " ",
      element("span", { class: `badge ${capture.state}` }, STATES[capture.state])),
    element("p", { class: "quiet path" }, capture.source),
  ]);
  showRun(capture);
  const check = checks[capture.id] ?? null;
  refresh(part("photographs-content"), [["checking", "check_failed", "running"].indexOf(capture.state),
    capture.check_sentence, check], () => photographs(capture, check, actions));
  const startable = !["checking", "running", "check_failed"].includes(capture.state);
  part("reconstruction").hidden = !startable;
  refresh(part("reconstruction-content"), startable ? [capture.state, presets, capture.preset, capture.settings, capture.scan,
    capture.scans] : null,
    () => (startable ? [startForm(capture, presets, actions)] : []));
  const removable = !["checking", "running"].includes(capture.state);
  refresh(part("removal"), removable ? [capture.is_own] : null, () => (removable ? removal(capture, actions) : []));
}

function showRun(capture) {
  const { run, state } = capture;
  part("result").hidden = !run?.has_result;
  if (run?.has_result) {
    refresh(part("result-content"), [state, run.files, run.decisions], () => results(capture));
  }
  part("progress").hidden = !run;
  if (!run) return;
  const content = part("progress-content");
  if (!content.childElementCount) {
    content.append(...["run-sentence", "run-stages", "run-preview", "run-buttons", "run-messages"].map(
      (id) => element("div", { id })));
  }
  const sentence = { failed: capture.sentence, stopped: "The run was stopped. Finished stages are kept." }[state] ?? "";
  refresh(part("run-sentence"), [state, sentence], () => [
    sentence && element("p", state === "failed" ? { class: "error", role: "alert" } : {}, sentence)]);
  refresh(part("run-stages"), [state, run.stages, run.progress], () => stages(capture));
  refresh(part("run-preview"), run.previews, () => preview(capture));
  refresh(part("run-buttons"), state === "running", () => [state === "running" && element("p", { class: "buttons" },
    element("button", { type: "button", id: "stop", onclick: actions.stop }, "Stop"),
    element("span", { class: "quiet" }, "A stopped run can be resumed."))]);
  refresh(part("run-messages"), run.messages, () => messages(run));
}

function tell(capture) {
  if (!capture) {
    document.title = "hir";
    return;
  }
  const doing = capture.state === "running" ? activity(capture.run) : STATES[capture.state];
  document.title = `${capture.name}: ${doing} – hir`;
  announce(`${capture.name}: ${doing}`);
}

async function update() {
  clearTimeout(timer);
  let pause = 1000;
  try {
    const state = await get(`state?capture=${encodeURIComponent(selected)}`);
    const capture = state.selected;
    if (!capture && state.captures.length && !selected) {
      selected = (state.captures.find(isBusy) ?? state.captures.at(-1)).id; // what is computed, or the last
      return await update();
    }
    if (capture?.checked && !checks[capture.id]) {
      checks[capture.id] = await get(`captures/${encodeURIComponent(capture.id)}/check.json`).catch(() => null);
    }
    if (capture && !capture.checked) delete checks[capture.id];
    if (capture && capture.id !== selected) return await update();
    part("folder").textContent = state.folder;
    showList(state.captures);
    showCapture(capture, state.presets);
    tell(capture);
    part("connection").textContent = "";
    document.documentElement.dataset.state = capture?.state ?? "empty";
    if (!state.captures.some(isBusy)) pause = 4000;
  } catch (error) {
    part("connection").textContent = error.message;
    pause = 4000;
  } finally {
    clearTimeout(timer);
    timer = setTimeout(update, pause);
  }
}

addEventListener("hashchange", () => select(decodeURIComponent(location.hash.slice(1))));
listenForCaptures();
update();
