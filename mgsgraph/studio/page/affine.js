// Where the pixels of an image lie on its canvas: an affine mapping, in CSS pixels.
// Places are [line, sample], the first pixel's center at [0.5, 0.5]; on the canvas x goes right and y goes down.

export class Affine {
  // x = at.x + a (sample - place[1]) + b (line - place[0]);  y = at.y + c (sample - place[1]) + d (line - place[0])
  constructor(place, at, a, b, c, d) {
    Object.assign(this, {place, at, a, b, c, d});
  }

  // [x, y] of a place
  toCanvas(line, sample) {
    const down = line - this.place[0], right = sample - this.place[1];
    return [this.at[0] + this.a * right + this.b * down, this.at[1] + this.c * right + this.d * down];
  }

  // [line, sample] of a point of the canvas
  toImage(x, y) {
    const dx = x - this.at[0], dy = y - this.at[1], whole = this.a * this.d - this.b * this.c;
    return [this.place[0] + (this.a * dy - this.c * dx) / whole, this.place[1] + (this.d * dx - this.b * dy) / whole];
  }

  // CSS pixels per image pixel, on the average of both directions
  get scale() {
    return Math.sqrt(Math.abs(this.a * this.d - this.b * this.c));
  }

  // Least and largest line and sample on a canvas of a size: [[line, line], [sample, sample]]
  bounds(width, height) {
    const corners = [[0, 0], [width, 0], [0, height], [width, height]].map(([x, y]) => this.toImage(x, y));
    return [0, 1].map(k => [Math.min(...corners.map(one => one[k])), Math.max(...corners.map(one => one[k]))]);
  }
}

// The first image, whose own pixels make the frame of all others: `center` is in the middle of the canvas; `axes` are
// a, b, c and d for a sample of about one CSS pixel.
export function ofFrame(center, zoom, axes, width, height) {
  return new Affine(center, [width / 2, height / 2], ...axes.map(one => zoom * one));
}

// Another image so that the same ground is at the same point of its canvas, exactly at a linked place and about it by
// the Jacobian (2 x 2: line and sample of this image by line and sample of the first one).
export function ofOther(frame, link, other) {
  const [[ll, ls], [sl, ss]] = other.jacobian, whole = ll * ss - ls * sl;
  if (!Number.isFinite(whole) || whole === 0) return null;
  // lines and samples of the first image by those of this one
  const back = [[ss / whole, -ls / whole], [-sl / whole, ll / whole]];
  const at = frame.toCanvas(link.line, link.sample);
  return new Affine(
    [other.line, other.sample], at,
    frame.a * back[1][1] + frame.b * back[0][1], frame.a * back[1][0] + frame.b * back[0][0],
    frame.c * back[1][1] + frame.d * back[0][1], frame.c * back[1][0] + frame.d * back[0][0],
  );
}

// The same with the image's own pixels as those of the first one, as large on the ground.
export function likeFrame(mapping, frame) {
  return new Affine(mapping.place, mapping.at, ...['a', 'b', 'c', 'd'].map(key => frame[key] * mapping.scale / frame.scale));
}
