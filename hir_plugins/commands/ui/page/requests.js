// Requests to the server of this page. Every error is an Error whose message is a sentence for the user.

const LOST = "The server does not answer. Start hir ui again and open the address that it prints.";

async function answerOf(response) {
  let document = null;
  try {
    document = await response.json();
  } catch {
    throw new Error(response.ok ? "The answer of the server is damaged." : LOST);
  }
  if (!response.ok) throw new Error(document.error ?? LOST);
  return document;
}

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", ...options });
  } catch {
    throw new Error(LOST);
  }
  return answerOf(response);
}

export const get = (path) => request(path);

export function post(path, document = {}) {
  const headers = { "Content-Type": "application/json" };
  return request(path, { method: "POST", headers, body: JSON.stringify(document) });
}

// Sends a file; `onBytes` gets the number of bytes that have been sent.
export function put(path, file, onBytes, signal) {
  return new Promise((resolve, reject) => {
    const sending = new XMLHttpRequest();
    sending.open("PUT", path);
    sending.upload.onprogress = (event) => onBytes(event.loaded);
    sending.onload = () => {
      if (sending.status === 200) return resolve();
      try {
        reject(new Error(JSON.parse(sending.responseText).error));
      } catch {
        reject(new Error(LOST));
      }
    };
    sending.onerror = () => reject(new Error(`${file.name} could not be read or sent; choose the folder again.`));
    sending.onabort = () => reject(new Error("cancelled"));
    signal.addEventListener("abort", () => sending.abort());
    sending.send(file);
  });
}
