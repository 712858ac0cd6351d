"use strict";
// options after the #: still (the asset does not rotate), theme=dark, theme=light
const options = new URLSearchParams(location.hash.slice(1));
if (options.has("theme")) document.documentElement.dataset.theme = options.get("theme");
const slides = [...document.querySelectorAll(".slide")];
let current = 0;
function show(index) {
  current = (index + slides.length) % slides.length;
  slides.forEach((slide, i) => slide.classList.toggle("shown", i === current));
  document.getElementById("position").textContent = `${current + 1} of ${slides.length}`;
  document.querySelectorAll(".thumb").forEach((thumb, i) => thumb.classList.toggle("chosen", i === current));
}
if (slides.length) {
  show(0);
  document.getElementById("previous").onclick = () => show(current - 1);
  document.getElementById("next").onclick = () => show(current + 1);
}
for (const compare of document.querySelectorAll(".compare")) {
  const range = compare.querySelector("input");
  range.oninput = () => compare.style.setProperty("--at", `${range.value}%`);
}
document.getElementById("difference").onchange = (event) =>
  document.getElementById("slides").classList.toggle("differences", event.target.checked);
document.getElementById("theme").onclick = () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
};

for (const thumb of document.querySelectorAll(".thumb")) thumb.onclick = () => show(Number(thumb.dataset.at));

// the page of the asset is unpacked into its own frame after the rest of the page is loaded
const frame = document.getElementById("model");
async function openModel() {
  const packed = Uint8Array.from(atob(document.getElementById("packed-model").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const page = new Blob([await new Response(stream).arrayBuffer()], { type: "text/html" });
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches || options.has("still");
  frame.src = `${URL.createObjectURL(page)}#bare${still ? "" : "&spin=1"}`;
}
if (frame) {
  openModel();
  const buttons = [...document.querySelectorAll(".channels [data-channel]")], wires = document.getElementById("wires");
  const postState = () => frame.contentWindow.postMessage({
    sender: "hir report",
    channel: buttons.find((button) => button.classList.contains("chosen")).dataset.channel,
    wireframe: wires.classList.contains("chosen"),
  }, "*");
  for (const button of buttons) {
    button.onclick = () => { buttons.forEach((other) => other.classList.toggle("chosen", other === button)); postState(); };
  }
  wires.onclick = () => { wires.classList.toggle("chosen"); postState(); };
}
