// Reference MikkTSpace tangents. Usage: node mikktspace.cjs IN OUT
// IN: float32, per corner x y z nx ny nz u v; OUT: float32, per corner x y z w, as the package gives them.
const fs = require("fs");
const { generateTangents } = require("mikktspace");

const [input, output] = process.argv.slice(2);
const bytes = fs.readFileSync(input);
const values = new Float32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const corners = values.length / 8;
const part = (offset, width) =>
  Float32Array.from({ length: corners * width }, (_, i) => values[Math.floor(i / width) * 8 + offset + (i % width)]);
const tangents = generateTangents(part(0, 3), part(3, 3), part(6, 2));
fs.writeFileSync(output, Buffer.from(tangents.buffer, tangents.byteOffset, tangents.byteLength));
