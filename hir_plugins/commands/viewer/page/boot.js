// Decompresses the embedded parts of this page and starts the viewer. Each module becomes a blob; its import statements
// are rewritten to the addresses of the blobs before it.
(async () => {
  document.body.classList.toggle("bare", new URLSearchParams(location.hash.slice(1)).has("bare"));
  const bytesOf = async (name) => {
    const element = document.getElementById(`part ${name}`);
    if (!element) return null;
    const packed = Uint8Array.from(atob(element.textContent), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  };
  const showState = (text, failed) => {
    const state = document.getElementById("state");
    state.textContent = text;
    state.classList.toggle("failed", Boolean(failed));
  };
  try {
    const { modules, initialDirection, photographs } = JSON.parse(document.getElementById("settings").textContent);
    const addresses = {};
    for (const { name, imports } of modules) {
      let text = new TextDecoder().decode(await bytesOf(name));
      for (const [specifier, module] of Object.entries(imports)) {
        for (const quote of ["'", '"']) { // minified modules have no space before the specifier
          text = text.replaceAll(`from ${quote}${specifier}${quote}`, `from "${addresses[module]}"`);
          text = text.replaceAll(`from${quote}${specifier}${quote}`, `from "${addresses[module]}"`);
        }
      }
      addresses[name] = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    }
    const { start } = await import(addresses["viewer.js"]);
    for (const photograph of photographs) {
      photograph.address = URL.createObjectURL(new Blob([await bytesOf(photograph.part)], { type: "image/png" }));
    }
    await start({ asset: await bytesOf("asset.glb"), light: await bytesOf("light.hdr"), initialDirection, photographs });
    showState("");
    document.documentElement.dataset.ready = "yes";
  } catch (error) {
    showState(`cannot be displayed: ${error.message || error}`, true);
    document.documentElement.dataset.ready = "failed";
  }
})();
