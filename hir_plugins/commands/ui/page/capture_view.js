// The photographs of the selected capture: what `hir check` found, and the form that starts a run.

import { element, percent } from "./elements.js";

export const STATES = {
  new: "not checked", checking: "checking", checked: "ready", check_failed: "cannot be read", running: "running",
  failed: "failed", stopped: "stopped", finished: "finished",
};

const address = (capture) => `captures/${encodeURIComponent(capture.id)}`;

// One line about all photographs, as `hir check` prints it.
function summary(check) {
  const views = check.views;
  const sizes = [...new Set(views.map((view) => `${view.width}×${view.height}`))];
  const masks = views.filter((view) => view.mask_share !== null).length;
  const parts = [
    `${views.length} photographs of ${sizes.length === 1 ? sizes[0] : `${sizes.length} sizes`}`,
    check.with_camera ? `${check.with_camera} with cameras` : "cameras will be estimated",
    masks ? `${masks} with masks` : "masks will be found",
  ];
  const takes = check.takes ?? []; // checks of older versions have none
  if (takes.length) {
    parts.push(`${takes.length} takes (${takes.map((take) => `${take.name} ${take.photographs}`).join(", ")})`);
  }
  const scores = views.map((view) => view.agreement).filter((score) => score !== null).sort((a, b) => a - b);
  if (scores.length) {
    const middle = scores[Math.floor(scores.length / 2)];
    parts.push(`masks and cameras agree to ${middle.toFixed(2)} (worst ${scores[0].toFixed(2)})`);
  }
  if (check.directions_covered !== null) parts.push(`${percent(check.directions_covered)} of all directions covered`);
  return parts.join(", ");
}

function photographTable(views) {
  const number = (value, digits) => (value === null ? "–" : value.toFixed(digits));
  const heads = ["photograph", "size", "agreement", "sharpness", "clipped", "brightness", "mask"];
  const rows = views.map((view) => element("tr", {},
    element("th", { scope: "row" }, view.name),
    ...[
      `${view.width}×${view.height}`, number(view.agreement, 2), number(view.sharpness, 2), percent(view.saturated),
      number(view.brightness, 3), view.mask_share === null ? "–" : percent(view.mask_share),
    ].map((text) => element("td", {}, text))));
  return element("div", { class: "wide", tabindex: "0", role: "region", "aria-label": "table of photographs" },
    element("table", {},
      element("thead", {}, element("tr", {}, heads.map((head) => element("th", { scope: "col" }, head)))),
      element("tbody", {}, rows)));
}

// Of the photographs. `check` is the document of `hir check --json`, or null.
export function photographs(capture, check, actions) {
  if (capture.state === "checking") {
    return [
      element("p", { id: "checking" }, "The photographs are being checked …"),
      element("progress", { "aria-labelledby": "checking" }),
      element("p", { class: "buttons" }, element("button", { type: "button", id: "stop", onclick: actions.stop }, "Stop")),
    ];
  }
  const again = capture.state === "running" ? null : element("button", {
    type: "button", id: "check", onclick: actions.check,
  }, capture.checked ? "Check again" : "Check");
  if (capture.check_sentence) {
    return [element("p", { class: "error", role: "alert" }, capture.check_sentence), element("p", { class: "buttons" }, again)];
  }
  if (!check) return [element("p", {}, "They have not been checked."), element("p", { class: "buttons" }, again)];
  const advice = check.advice.length
    ? element("ul", { class: "advice" }, check.advice.map((sentence) => element("li", {}, sentence)))
    : element("p", { class: "good" }, "No problems found.");
  const sheet = `${address(capture)}/sheet.png`;
  return [
    element("p", {}, `${summary(check)}.`),
    advice,
    element("a", { href: sheet, target: "_blank", rel: "noopener", class: "sheet" },
      element("img", { src: sheet, alt: `contact sheet: ${check.views.length} photographs with their masks` })),
    element("details", { id: "photograph-details" }, element("summary", {}, "Each photograph"),
      photographTable(check.views)),
    element("p", { class: "buttons" }, again),
  ];
}

const BUTTONS = { stopped: "Resume", failed: "Try again", finished: "Run again" };

// The form that starts or resumes a run.
export function startForm(capture, presets, actions) {
  const used = presets.some((preset) => preset.name === capture.preset) ? capture.preset : null;
  const scan = element("input", {
    id: "scan", type: "text", autocomplete: "off", spellcheck: "false", list: "scans", "aria-describedby": "scan-help",
    value: capture.scan || (capture.scans.length === 1 ? capture.scans[0] : ""),
  });
  const scanField = element("div", { id: "scan-field" },
    element("label", { for: "scan" }, "Scan whose mesh and texture coordinates are kept"), scan,
    element("datalist", { id: "scans" }, capture.scans.map((path) => element("option", { value: path }))),
    element("p", { id: "scan-help", class: "quiet" },
      "A mesh among the photographs, or its whole path on this machine (.glb, .gltf, .obj, .ply). It must be in the ",
      "axes of the cameras; without cameras it is aligned with the photographs."));
  const choices = presets.map((preset) => element("label", { class: "choice" },
    element("input", {
      type: "radio", name: "preset", value: preset.name, checked: used ? preset.name === used : preset.default,
    }),
    element("span", {}, element("strong", {}, preset.name), preset.summary ? ` ${preset.summary}` : "")));
  const settings = element("textarea", {
    id: "settings", rows: "3", spellcheck: "false", "aria-describedby": "settings-help",
  }, capture.settings.join("\n"));
  const form = element("form", { id: "start-form" },
    element("fieldset", {}, element("legend", {}, "Preset"), choices), scanField,
    element("details", { id: "settings-details", open: capture.settings.length > 0 },
      element("summary", {}, "Settings"),
      element("label", { for: "settings" }, "Settings besides the preset"),
      settings,
      element("p", { id: "settings-help", class: "quiet" },
        "One KEY=VALUE a line, such as geometry.triangles=20000. docs/reference/options.md lists all.")),
    element("p", { class: "buttons" },
      element("button", { id: "start", class: "main" }, BUTTONS[capture.state] ?? "Start"),
      capture.state === "stopped" || capture.state === "failed"
        ? element("span", { class: "quiet" }, "Finished stages are used again where their settings are the same.") : null),
    element("p", { id: "start-error", class: "error", role: "alert" }));
  const needsScan = () => presets.find(({ name }) => name === form.elements.preset.value)?.needs_scan ?? false;
  const showScan = () => { scanField.hidden = !needsScan(); };
  form.addEventListener("change", showScan);
  showScan();
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const lines = settings.value.split("\n").map((line) => line.trim()).filter(Boolean);
    actions.start(form.elements.preset.value, lines, needsScan() ? scan.value : "");
  });
  return form;
}

// Removes the capture from the page; a second press confirms.
export function removal(capture, actions) {
  const lost = capture.is_own ? "the copied photographs, their check and the run"
    : "the check and the run; the photographs stay where they are";
  const place = element("p", { class: "buttons" });
  const ask = () => place.replaceChildren(element("button", { type: "button", id: "remove", onclick: confirm }, "Remove …"));
  const confirm = () => {
    const keep = element("button", { type: "button", id: "keep", onclick: () => { ask(); place.firstChild.focus(); } }, "Keep");
    place.replaceChildren(
      element("button", { type: "button", id: "confirm-removal", class: "danger", onclick: actions.remove }, "Remove"), keep,
      element("span", { role: "status" }, `This deletes ${lost}.`));
    keep.focus();
  };
  ask();
  return [place, element("p", { id: "remove-error", class: "error", role: "alert" })];
}
