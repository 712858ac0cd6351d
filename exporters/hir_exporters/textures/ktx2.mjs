// Encodes and decodes KTX2 with the Basis Universal build of the npm package ktx2-encoder.
//
//   node ktx2.mjs BASIS_MODULE encode WIDTH HEIGHT color|linear|normal QUALITY   RGBA in, KTX2 out
//   node ktx2.mjs BASIS_MODULE decode                            KTX2 in; width, height (4 bytes each), RGBA out
//
// Input is standard input, output is standard output. QUALITY is that of ETC1S, 1 to 255; 0 is UASTC.

import { readFileSync, writeSync } from "node:fs";
import { pathToFileURL } from "node:url";

const RAW = 0; // kind of a source image: RGBA
const UASTC_LEVEL = 1; // of 0 to 4
const ETC1S_LEVEL = 2; // of 0 to 6
const RGBA32 = 13;
const SLACK = 1 << 16;

const [modulePath, operation, ...words] = process.argv.slice(2);

function encoded(basis, pixels, width, height, kind, quality) {
  const encoder = new basis.BasisEncoder();
  encoder.setCreateKTX2File(true);
  encoder.setTexType(basis.basis_texture_type.cBASISTexType2D);
  if (!encoder.setSliceSourceImage(0, pixels, width, height, RAW)) throw new Error("the image was refused");
  encoder.setUASTC(quality === 0);
  if (quality === 0) {
    encoder.setPackUASTCFlags(UASTC_LEVEL);
    encoder.setKTX2UASTCSupercompression(true);
  } else {
    encoder.setQualityLevel(quality);
    encoder.setETC1SCompressionLevel(ETC1S_LEVEL);
  }
  if (kind === "normal") encoder.setNormalMapPreset();
  // with the sRGB options: perceptual weights, filtering of mipmaps and transfer function of the file
  encoder.setPerceptual(kind === "color");
  encoder.setMipSRGB(kind === "color");
  encoder.setKTX2AndBasisSRGBTransferFunc(kind === "color");
  encoder.setMipGen(true);
  encoder.setMipRenormalize(kind === "normal");
  const output = new Uint8Array(Math.ceil((width * height * 16) / 3) + SLACK);
  const size = encoder.encode(output);
  if (!size) throw new Error("the encoder gave no file");
  return output.subarray(0, size);
}

function decoded(basis, data) {
  const file = new basis.KTX2File(data);
  if (!file.isValid() || !file.isLDR() || !file.startTranscoding()) throw new Error("it is no KTX2 file of Basis Universal");
  const pixels = new Uint8Array(file.getImageTranscodedSizeInBytes(0, 0, 0, RGBA32));
  if (!file.transcodeImage(pixels, 0, 0, 0, RGBA32, 0, -1, -1)) throw new Error("its image cannot be decoded");
  const size = new Uint32Array([file.getWidth(), file.getHeight()]);
  return Buffer.concat([Buffer.from(size.buffer), pixels]);
}

const { default: start } = await import(pathToFileURL(modulePath));
const basis = await start({ print: () => {}, printErr: () => {} });
basis.initializeBasis();
const input = new Uint8Array(readFileSync(0));
const result =
  operation === "decode"
    ? decoded(basis, input)
    : encoded(basis, input, Number(words[0]), Number(words[1]), words[2], Number(words[3]));
for (let sent = 0; sent < result.length; ) sent += writeSync(1, result, sent);
