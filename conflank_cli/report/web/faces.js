// The design faces: a mesh of each, and on it a picture of what the program leaves there.

import * as THREE from "three";

export const FAR = 32767; // in a gap: further off than was computed

function channels(hex) {
  const value = parseInt(hex.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

// Colour of a gap in um: the scale's own between the tolerances, one colour each for what is beyond them.
export function gapScale(colours, overcut, undercut) {
  const stops = colours.gap.map(([place, hex]) => [place, channels(hex)]);
  const deep = channels(colours.overcut);
  const left = channels(colours.left);
  return (gap) => {
    if (gap > undercut) return left;
    if (gap < -overcut) return deep;
    const share = gap < 0 ? 0.5 + (0.5 * gap) / overcut : 0.5 + (0.5 * gap) / (undercut || 1);
    let k = 1;
    while (k < stops.length - 1 && stops[k][0] < share) k++;
    const [[a, from], [b, to]] = [stops[k - 1], stops[k]];
    const t = (share - a) / (b - a);
    return from.map((value, c) => value + t * (to[c] - value));
  };
}

export class Face {
  constructor(entry, arrays, report) {
    this.entry = entry;
    this.report = report;
    const prefix = `face${entry.index}_`;
    [this.columns, this.rows] = entry.grid;
    this.gap = arrays[`${prefix}gap`];
    this.inside = arrays[`${prefix}inside`];
    this.reason = arrays[`${prefix}reason`];
    this.reach = Object.fromEntries(
      report.reach.filter((each) => each.face === entry.index).map((each) => [each.key, arrays[`${prefix}${each.key}`]]),
    );
    this.byCut = new Map(entry.cuts.map((cut) => [cut, arrays[`${prefix}cut${cut}`]]));
    this.pixels = new Uint8Array(4 * this.columns * this.rows);
    this.texture = new THREE.DataTexture(this.pixels, this.columns, this.rows);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    this.texture.magFilter = THREE.LinearFilter;
    this.texture.minFilter = THREE.LinearMipmapLinearFilter;
    this.texture.generateMipmaps = true;
    this.texture.anisotropy = 4;
    this.mesh = new THREE.Mesh(
      this.geometry(arrays[`${prefix}points`], entry),
      new THREE.MeshLambertMaterial({ map: this.texture, side: THREE.DoubleSide, alphaTest: 0.5 }),
    );
    this.mesh.userData.face = this;
  }

  geometry(points, entry) {
    const [columns, rows] = entry.mesh;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    const uv = new Float32Array(2 * columns * rows);
    const index = [];
    for (let i = 0; i < columns; i++) {
      for (let j = 0; j < rows; j++) {
        const k = i * rows + j;
        // The grid's first and last values stand in the middles of the picture's first and last pixels.
        uv[2 * k] = (0.5 + (i / (columns - 1)) * (this.columns - 1)) / this.columns;
        uv[2 * k + 1] = (0.5 + (j / (rows - 1)) * (this.rows - 1)) / this.rows;
        if (i + 1 < columns && j + 1 < rows) {
          const corners = [k, k + rows, k + rows + 1, k + 1];
          if (entry.sense < 0) corners.reverse();
          index.push(corners[0], corners[1], corners[2], corners[0], corners[2], corners[3]);
        }
      }
    }
    geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
    geometry.setIndex(index);
    geometry.computeVertexNormals();
    return geometry;
  }

  // Gap in um at a place of the picture, and the cut that goes deepest there (-1: none comes near).
  value(k, shown) {
    let lowest = FAR;
    let cut = -1;
    for (const [number, gaps] of this.byCut) {
      if (shown.has(number) && gaps[k] < lowest) [lowest, cut] = [gaps[k], number];
    }
    if (shown.all) lowest = this.gap[k];
    return { gap: lowest === FAR ? Infinity : lowest * this.report.gap_step_um, cut };
  }

  // Draw the picture: `mode` is what colours mean, `shown` the cuts that count (a set; .all where it is every one).
  paint(mode, shown, scale) {
    const { overcut_um: overcut, undercut_um: undercut } = this.report.tolerance;
    const colours = this.report.colours;
    const cuts = this.report.cuts.map((cut) => channels(cut.colour));
    const left = channels(colours.left);
    const reasons = colours.reasons.map(channels);
    const ramp = colours.reach.map(channels);
    const reach = this.reach[mode];
    const count = this.columns * this.rows;
    for (let k = 0; k < count; k++) {
      // Arrays run along v first, pictures along u.
      const at = 4 * ((k % this.rows) * this.columns + Math.floor(k / this.rows));
      // Off the face as well, where the picture is see-through: smoothing must not mix anything else in at its border.
      const { gap, cut } = this.value(k, shown);
      let colour = left;
      if (mode === "gap") colour = scale(gap);
      else if (mode === "cut" && cut >= 0 && gap <= undercut && gap >= -overcut) colour = cuts[cut];
      else if (mode === "reason" && this.reason) colour = reasons[this.reason[k]];
      else if (reach && reach[k] < 255) {
        const place = (reach[k] / 254) * (ramp.length - 1);
        const low = Math.min(Math.floor(place), ramp.length - 2);
        colour = ramp[low].map((value, c) => value + (place - low) * (ramp[low + 1][c] - value));
      }
      this.pixels[at] = colour[0];
      this.pixels[at + 1] = colour[1];
      this.pixels[at + 2] = colour[2];
      this.pixels[at + 3] = this.inside[k];
    }
    this.texture.needsUpdate = true;
  }

  // Index of the picture's value at texture coordinates.
  indexAt(uv) {
    const i = Math.min(Math.max(Math.round(uv.x * this.columns - 0.5), 0), this.columns - 1);
    const j = Math.min(Math.max(Math.round(uv.y * this.rows - 0.5), 0), this.rows - 1);
    return i * this.rows + j;
  }
}
