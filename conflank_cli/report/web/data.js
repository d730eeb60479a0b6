// The report's data as the page carries it: a JSON document, and one deflated block of bytes for all arrays.

const TYPES = { u1: Uint8Array, i2: Int16Array, u2: Uint16Array, i4: Int32Array, f4: Float32Array, f8: Float64Array };

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}

// Bytes of equal weight stand together (all lowest, then all second ...), and whole numbers as differences: both make
// them easier to deflate. This undoes it.
function unpacked(bytes, entry) {
  const size = Number(entry.type[1]);
  const count = entry.bytes / size;
  const plain = new Uint8Array(entry.bytes);
  for (let plane = 0; plane < size; plane++) {
    const from = entry.offset + plane * count;
    for (let k = 0; k < count; k++) plain[k * size + plane] = bytes[from + k];
  }
  const values = new TYPES[entry.type](plain.buffer);
  // The typed array itself wraps round as the differences did.
  if (entry.differences) for (let k = 1; k < count; k++) values[k] += values[k - 1];
  if (!entry.step) return values;
  const scaled = new Float32Array(count);
  const width = entry.low.length;
  for (let k = 0; k < count; k++) scaled[k] = entry.low[k % width] + values[k] * entry.step[k % width];
  return scaled;
}

export async function readReport() {
  const report = JSON.parse(document.getElementById("report").textContent);
  const packed = bytesOf(document.getElementById("arrays").textContent.trim());
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const arrays = {};
  for (const [name, entry] of Object.entries(report.arrays)) arrays[name] = unpacked(bytes, entry);
  return { report, arrays };
}
