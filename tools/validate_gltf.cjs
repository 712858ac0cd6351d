// Khronos' validator. Usage: node validate_gltf.cjs FILE...; prints one JSON report a line, in the order given.
const fs = require("fs");
const path = require("path");
const validator = require("gltf-validator");

async function main() {
  for (const file of process.argv.slice(2)) {
    const folder = path.dirname(file);
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
      uri: path.basename(file),
      maxIssues: 100,
      externalResourceFunction: async (uri) =>
        new Uint8Array(fs.readFileSync(path.join(folder, decodeURIComponent(uri)))),
    });
    console.log(JSON.stringify(report));
  }
}

main().catch((error) => {
  console.error(String(error));
  process.exit(1);
});
