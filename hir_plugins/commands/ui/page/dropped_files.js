// The files of what a user drops or chooses, with their paths below the capture's folder.

const MAX_FILES = 20000; // as the server's

const hidden = (path) => path.split("/").some((part) => part.startsWith(".") || part === "__MACOSX") ||
  /(^|\/)(Thumbs\.db|desktop\.ini)$/i.test(path);

function capture(name, files) {
  const visible = files.filter(({ path }) => !hidden(path));
  if (!visible.length) throw new Error(`${name} holds no files.`);
  return { name, files: visible };
}

// What a drop holds: one folder, or files that become one capture. The entries must be taken before anything is awaited.
export function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  return readEntries(entries);
}

async function readEntries(entries) {
  if (!entries.length) throw new Error("Drop a folder of photographs, or photographs.");
  const files = [];
  if (entries.length === 1 && entries[0].isDirectory) {
    await addFolder(entries[0], "", files);
    return capture(entries[0].name, files);
  }
  for (const entry of entries) await add(entry, "", files);
  return capture(entries.length === 1 ? entries[0].name.replace(/\.[^.]*$/, "") : "photographs", files);
}

async function add(entry, parent, files) {
  if (hidden(entry.name)) return;
  if (entry.isDirectory) return addFolder(entry, `${parent}${entry.name}/`, files);
  const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
  files.push({ path: parent + entry.name, file });
  if (files.length > MAX_FILES) {
    throw new Error("The folder holds more than 20,000 files. Drop the folder of one capture, or type its path.");
  }
}

async function addFolder(folder, path, files) {
  const reader = folder.createReader();
  for (;;) { // a reader returns at most 100 entries at a time
    const entries = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!entries.length) return;
    for (const entry of entries) await add(entry, path, files);
  }
}

// What an <input type="file"> holds.
export function chosen(list) {
  const files = [...list];
  if (!files.length) throw new Error("The folder holds no files.");
  const inFolder = files[0].webkitRelativePath;
  if (!inFolder) {
    const name = files.length === 1 ? files[0].name.replace(/\.[^.]*$/, "") : "photographs";
    return capture(name, files.map((file) => ({ path: file.name, file })));
  }
  const name = inFolder.split("/")[0];
  return capture(name, files.map((file) => ({ path: file.webkitRelativePath.slice(name.length + 1), file })));
}
