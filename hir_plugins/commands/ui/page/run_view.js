// A run: its stages, the preview, the messages, and at the end the report and the files.

import { bytesText, element, secondsText } from "./elements.js";

const address = (capture) => `captures/${encodeURIComponent(capture.id)}`;

// The stage that is computed now; null before the first and after the last.
export function currentStage(run) {
  const started = run.progress?.stage;
  const named = run.stages.find((stage) => stage.name === started && !stage.finished);
  return named ?? (run.progress ? run.stages.find((stage) => !stage.finished) ?? null : null);
}

// What is happening, in a few words.
export function activity(run) {
  const stage = currentStage(run);
  if (stage) return `stage ${run.stages.indexOf(stage) + 1} of ${run.stages.length}: ${stage.name}`;
  return run.stages.every((each) => each.finished) ? "writing the report" : "reading the photographs";
}

function stageItem(stage, current, running, progress) {
  if (stage !== current || !running) {
    const mark = stage.finished ? "done" : "waiting";
    const text = stage.finished ? (stage.seconds === null ? "done" : secondsText(stage.seconds)) : "";
    return element("li", { class: mark }, element("span", { class: "name" }, stage.name),
      element("span", { class: "quiet" }, text),
      element("span", { class: "unseen" }, stage.finished ? " finished" : " not started"));
  }
  const own = progress?.stage === stage.name ? progress : null;
  const facts = [];
  if (own) {
    if (own.steps > 1) facts.push(`step ${own.step} of ${own.steps}`);
    if (own.seconds_left >= 1 && own.step < own.steps) facts.push(`about ${secondsText(own.seconds_left)} left`);
    if (own.error) facts.push(own.error);
    if (own.message) facts.push(own.message);
  }
  const known = own && own.steps > 1;
  return element("li", { class: "current", "aria-current": "step" },
    element("span", { class: "name", id: "current-stage" }, stage.name),
    element("progress", {
      "aria-labelledby": "current-stage", max: known ? own.steps : false, value: known ? own.step : false,
    }),
    element("span", { class: "quiet facts" }, facts.join(" · ")));
}

export function stages(capture) {
  const run = capture.run, running = capture.state === "running";
  const current = running ? currentStage(run) : null;
  return [
    running ? element("p", { class: "activity" }, `Now ${activity(run)}.`) : null,
    element("ol", { class: "stages" }, run.stages.map((stage) => stageItem(stage, current, running, run.progress))),
  ];
}

export function preview(capture) {
  const last = capture.run.previews.at(-1);
  if (!last) return [];
  const source = `${address(capture)}/previews/${last.stage}.png?${last.version}`;
  return [element("figure", {},
    element("img", { src: source, alt: `the object after the stage ${last.stage}, from four sides` }),
    element("figcaption", { class: "quiet" }, `after the stage ${last.stage}`))];
}

export function messages(run) {
  if (!run.messages.length) return [];
  const warnings = run.messages.filter((line) => line.includes("warning:")).length;
  const title = warnings ? `Messages (${warnings} ${warnings === 1 ? "warning" : "warnings"})` : "Messages";
  return [element("details", { id: "messages" }, element("summary", {}, title),
    element("ul", { class: "log" },
      run.messages.map((line) => element("li", { class: line.includes("warning:") ? "warning" : "" }, line))))];
}

export function results(capture) {
  const run = capture.run;
  const encoded = (path) => path.split("/").map(encodeURIComponent).join("/");
  const found = Object.entries(run.decisions).map(([name, sentence]) => [
    element("dt", {}, name), element("dd", {}, sentence),
  ]);
  const newer = { failed: "failed", stopped: "was stopped" }[capture.state];
  return [
    newer ? element("p", {}, `This is the result of an earlier run. The latest one ${newer}.`) : null,
    element("p", { class: "buttons" },
      element("a", { id: "report", class: "button main", href: `${address(capture)}/report.html`, target: "_blank",
        rel: "noopener" }, "Open the report"),
      run.files.length ? element("a", { id: "archive", class: "button", href: `${address(capture)}/exports.zip`,
        download: `${capture.id}.zip` }, "Download all files (.zip)") : null),
    found.length ? element("dl", {}, found) : null,
    run.files.length ? element("ul", { class: "files" }, run.files.map((file) => element("li", {},
      element("a", { href: `${address(capture)}/exports/${encoded(file.path)}`, download: file.path.split("/").at(-1) },
        file.path),
      element("span", { class: "quiet" }, ` ${bytesText(file.bytes)}`)))) : element("p", {}, "No format was exported."),
  ];
}
