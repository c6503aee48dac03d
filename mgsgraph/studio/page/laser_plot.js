// Laser profile beside an image: heights along the track with their sigmas, before and after the adjustment.

import {COLOURS} from './image_marks.js';
import {axes, make, prepared, range, short} from './plot.js';

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

// Draws the profile of the nearest shot, else the longest one; returns its caption
export function drawLaser(canvas, image, near) {
  const {profiles, above} = image.shots;
  if (!profiles.length) return 'No laser shot falls in this image.';
  canvas.hidden = false;
  const profile = near?.profile || profiles.reduce((best, one) => one.names.length > best.names.length ? one : best);
  const along = profile.along_m.map(one => one / 1000), heights = profile.height_m, sigmas = profile.sigma_m;
  const y = range([
    ...heights.map((one, k) => one === null ? null : one + (sigmas[k] || 0)),
    ...heights.map((one, k) => one === null ? null : one - (sigmas[k] || 0)), ...profile.height_before_m,
  ]);
  const x = range(along, 0.02);
  if (!y || !canvas.clientWidth) return `Profile ${profile.name}: no heights.`;
  const drawn = axes(canvas, {x, y, xLabel: 'along the track (km)', yLabel: `height above the ${above} (m)`});
  const {context, toX, toY} = drawn;
  context.strokeStyle = COLOURS.after;
  context.fillStyle = COLOURS.after;
  context.lineWidth = 1.2;
  along.forEach((at, k) => {
    const height = heights[k];
    if (height === null) return;
    const px = toX(at), py = toY(height), sigma = sigmas[k] || 0;
    context.beginPath();
    context.moveTo(px, toY(height - sigma));
    context.lineTo(px, toY(height + sigma));
    context.stroke();
    context.beginPath();
    context.arc(px, py, 2.6, 0, 7);
    context.fill();
  });
  context.strokeStyle = COLOURS.before;
  profile.height_before_m.forEach((height, k) => {
    if (height === null) return;
    context.beginPath();
    context.arc(toX(along[k]), toY(height), 4.2, 0, 7);
    context.stroke();
  });
  if (near) {
    context.strokeStyle = drawn.colours.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(toX(along[near.k]), drawn.box.top);
    context.lineTo(toX(along[near.k]), drawn.box.bottom);
    context.stroke();
  }
  canvas.nearest = px => {
    const [at] = drawn.inverse(px, 0);
    let k = 0;
    along.forEach((one, i) => { if (Math.abs(one - at) < Math.abs(along[k] - at)) k = i; });
    return {profile, k};
  };
  return words(profile, image, above, near);
}

function words(profile, image, above, near) {
  const known = profile.sigma_m.filter(one => one !== null).sort((a, b) => a - b);
  const sigma = known.length ? `, median sigma ${short(known[known.length >> 1], 2)} m` : '';
  const one = near && near.profile === profile
    ? ` Shot ${profile.names[near.k]}: ${short(profile.height_m[near.k], 6)} m, sigma ${short(profile.sigma_m[near.k], 2)} m.` : '';
  return `Laser profile ${profile.name} in ${image.name}: ${profile.names.length} shots, heights above the ${above} along `
    + `the track with one sigma${sigma}; orange rings before the adjustment, blue dots after it.${one}`;
}
