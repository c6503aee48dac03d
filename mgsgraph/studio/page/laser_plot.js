// Laser profile beside an image: heights along the track with their sigmas, before and after the adjustment.

import {axes, range, short} from './plot.js';

const NEAR = 30; // CSS pixels, from a shot that is marked

// The shot of a pane's image nearest to the cross; null where none is near
export function nearestShot(pane, mapping, cursor) {
  if (!mapping || !pane.image) return null;
  const x = pane.canvas.clientWidth / 2 + cursor[0], y = pane.canvas.clientHeight / 2 + cursor[1];
  let found = null, least = NEAR;
  for (const profile of pane.image.shots.profiles)
    profile.after.forEach((place, k) => {
      if (!place) return;
      const at = mapping.toCanvas(...place), away = Math.hypot(at[0] - x, at[1] - y);
      if (away < least) [found, least] = [{profile, k}, away];
    });
  return found;
}

// Draws the profile of the nearest shot, else the longest one: heights, and what is above the surface; returns its caption
export function drawLaser(canvas, differences, image, near) {
  const {profiles, above, surface} = image.shots;
  if (!profiles.length) return 'No laser shot falls in this image.';
  const profile = near?.profile || profiles.reduce((best, one) => one.names.length > best.names.length ? one : best);
  const {height_before_m: before, height_m: after, surface_before_m: under, surface_m: ground, sigma_m: sigma} = profile;
  const less = (heights, other) => heights.map((one, k) => one === null || other[k] === null ? null : one - other[k]);
  const mark = near?.profile === profile ? near.k : null;
  differences.hidden = !surface;
  plot(canvas, profile, before, after, ground, `m above the ${above}`, mark);
  if (surface) plot(differences, profile, less(before, under), less(after, ground), after.map(() => 0), 'm above the surface', mark);
  return words(profile, image, mark);
}

// Heights before and after with one sigma, along the track, and a line
function plot(canvas, profile, before, after, line, yLabel, mark) {
  const along = profile.along_m.map(one => one / 1000), x = range(along, 0.02), sigma = profile.sigma_m;
  const reach = [-1, 1].flatMap(side => after.map((one, k) => one === null ? null : one + side * (sigma[k] || 0)));
  const y = range([...reach, ...before, ...line]);
  if (!y || !canvas.clientWidth) return;
  const drawn = axes(canvas, {x, y, xLabel: 'km along the track', yLabel}), {context, toX, toY, box} = drawn;
  const path = (values, step) => {
    const found = new Path2D();
    values.forEach((one, k) => { if (one !== null) step(found, toX(along[k]), toY(one), k); });
    return found;
  };
  const paint = (style, width, found) => {
    Object.assign(context, {strokeStyle: style, lineWidth: width});
    context.stroke(found);
  };
  paint(drawn.colors.ink, 1.2, path(line, (found, px, py) => found.lineTo(px, py)));
  paint(drawn.colors.before, 1.5, path(before, (found, px, py) => { found.moveTo(px + 2, py); found.arc(px, py, 2, 0, 7); }));
  paint(drawn.colors.after, 1, path(after, (found, px, py, k) => {
    const high = (sigma[k] || 0) * (toY(0) - toY(1));
    found.moveTo(px, py - high);
    found.lineTo(px, py + high);
    found.rect(px - 1, py - 1, 2, 2);
  }));
  if (mark !== null) paint(drawn.colors.ink, 1.5, path([y[0], y[1]], (found, _, py, k) => found[k ? 'lineTo' : 'moveTo'](toX(along[mark]), py)));
  canvas.nearest = px => {
    const [at] = drawn.inverse(px, 0);
    return {profile, k: along.reduce((best, one, k) => Math.abs(one - at) < Math.abs(along[best] - at) ? k : best, 0)};
  };
}

function words(profile, image, mark) {
  const {surface} = image.shots, known = profile.sigma_m.filter(one => one !== null).sort((a, b) => a - b);
  const sigma = known.length ? `, median sigma ${short(known[known.length >> 1], 2)} m` : '';
  const one = mark === null ? '' : ` Shot ${profile.names[mark]}: ${short(profile.height_m[mark], 6)} m, sigma ${short(profile.sigma_m[mark], 2)} m.`;
  return `${profile.name}: ${profile.names.length} shots${sigma}. ${surface ? `Line: ${surface}.` : 'No surface: no terrain model and too few points.'}${one}`;
}
