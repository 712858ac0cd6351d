// Elements made from text alone: nothing that a capture contains is read as HTML.

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== ""));
  return made;
}

// Replaces the content of `place` where `facts` have changed since the last call. The element that has the focus keeps
// it if the new content has one of the same id.
export function refresh(place, facts, make) {
  const key = JSON.stringify(facts);
  if (place.shownFacts === key) return;
  place.shownFacts = key;
  const focused = place.contains(document.activeElement) ? document.activeElement.id : null;
  const open = new Set([...place.querySelectorAll("details[open][id]")].map((details) => details.id));
  place.replaceChildren(...make().flat().filter(Boolean));
  for (const details of place.querySelectorAll("details[id]")) details.open ||= open.has(details.id);
  if (focused === null) return;
  const again = focused ? document.getElementById(focused) : null;
  const target = again ?? place.querySelector("button, a[href], [tabindex]");
  target?.focus({ preventScroll: true });
}

export function bytesText(bytes) {
  if (bytes < 1e5) return `${Math.max(1, Math.round(bytes / 1e3))} kB`;
  return bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
}

export function secondsText(seconds) {
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
  return `${Math.floor(whole / 3600)} h ${String(Math.floor((whole % 3600) / 60)).padStart(2, "0")} min`;
}

export function percent(share) {
  return `${(100 * share).toFixed(share < 0.1 ? 1 : 0)} %`;
}
