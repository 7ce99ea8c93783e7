// A circular arc through the points of one frame, and how far its tangent turns. The same fit as
// tracker/arc_fit.py, where the formulas are explained: curvature, direction and offset of the circle at the
// middle point, by Levenberg-Marquardt with Huber's weights.

const HUBER_FRACTION = 0.01;
const MAX_ITERATIONS = 60;
const TOLERANCE = 1e-18;

/** Turn of the fitted arc's tangent from the first to the last point, in rad; it may exceed pi. */
export function arcAngle(points) {
  const origin = points[points.length >> 1];
  let length = 0;
  for (let i = 1; i < points.length; i++) {
    length += Math.hypot(points[i][0] - points[i - 1][0], points[i][1] - points[i - 1][1]);
  }
  const scaled = points.map(([x, y]) => [(x - origin[0]) / length, (y - origin[1]) / length]);
  return turnOf(scaled, fit(scaled));
}

function fit(points) {
  let parameters = throughThreePoints(points);
  let damping = 1e-3;
  for (let iteration = 0; iteration < MAX_ITERATIONS; iteration++) {
    const { residuals, jacobian } = distances(points, parameters);
    const normal = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    const slope = [0, 0, 0];
    residuals.forEach((residual, k) => {
      const weight = HUBER_FRACTION / Math.max(Math.abs(residual), HUBER_FRACTION);
      for (let i = 0; i < 3; i++) {
        slope[i] += jacobian[k][i] * weight * residual;
        for (let j = 0; j < 3; j++) normal[i][j] += jacobian[k][i] * weight * jacobian[k][j];
      }
    });
    for (let i = 0; i < 3; i++) normal[i][i] += damping * (normal[i][i] + 1e-12);
    const step = solved(normal, slope);
    const trial = parameters.map((value, i) => value - step[i]);
    const better = huber(distances(points, trial).residuals) <= huber(residuals);
    if (better) parameters = trial;
    damping = Math.min(Math.max(damping * (better ? 0.2 : 5), 1e-12), 1e12);
    if (!(step[0] ** 2 + step[1] ** 2 + step[2] ** 2 > TOLERANCE)) break;
  }
  return parameters;
}

function throughThreePoints(points) {
  const first = points[0];
  const middle = points[points.length >> 1];
  const last = points.at(-1);
  const toMiddle = [middle[0] - first[0], middle[1] - first[1]];
  const toLast = [last[0] - middle[0], last[1] - middle[1]];
  const whole = [last[0] - first[0], last[1] - first[1]];
  const cross = toMiddle[0] * toLast[1] - toMiddle[1] * toLast[0];
  const sides = Math.hypot(...toMiddle) * Math.hypot(...toLast) * Math.hypot(...whole);
  const heading = ([x, y]) => Math.atan2(y, x);
  return [(2 * cross) / Math.max(sides, 1e-9), heading(toMiddle) + heading(toLast) - heading(whole), 0];
}

function frameOf(points, [curvature, direction, offset]) {
  const tangent = [Math.cos(direction), Math.sin(direction)];
  const normal = [-tangent[1], tangent[0]];
  const u = points.map(([x, y]) => [x - offset * normal[0], y - offset * normal[1]]);
  return { curvature, offset, tangent, normal, u };
}

function distances(points, parameters) {
  const { curvature, offset, tangent, normal, u } = frameOf(points, parameters);
  const residuals = [];
  const jacobian = [];
  for (const [x, y] of u) {
    const along = x * tangent[0] + y * tangent[1];
    const across = x * normal[0] + y * normal[1];
    const squared = x * x + y * y;
    const f = 0.5 * curvature * squared - across;
    const root = Math.max(Math.sqrt(Math.max(1 + 2 * curvature * f, 0)), 1e-6);
    const residual = (2 * f) / (1 + root);
    residuals.push(residual);
    jacobian.push([
      (0.5 * squared - 0.5 * residual ** 2) / root,
      ((1 + curvature * offset) * along) / root,
      (1 - curvature * across) / root,
    ]);
  }
  return { residuals, jacobian };
}

function turnOf(points, parameters) {
  const { curvature, normal, u } = frameOf(points, parameters);
  const inward = u.map(([x, y]) => [normal[0] - curvature * x, normal[1] - curvature * y]);
  let angle = 0;
  for (let i = 1; i < inward.length; i++) {
    const [before, after] = [inward[i - 1], inward[i]];
    const step = Math.atan2(
      before[0] * after[1] - before[1] * after[0],
      before[0] * after[0] + before[1] * after[1],
    );
    // More than half of the way round between neighbours: the circle is run through the curvature's way.
    const behind = step * curvature < 0 && Math.abs(step) > Math.PI / 2;
    angle += step + (behind ? 2 * Math.PI * Math.sign(curvature) : 0);
  }
  return angle;
}

function huber(residuals) {
  let sum = 0;
  for (const residual of residuals) {
    const size = Math.abs(residual);
    sum += size <= HUBER_FRACTION ? 0.5 * residual ** 2 : HUBER_FRACTION * (size - 0.5 * HUBER_FRACTION);
  }
  return sum;
}

/** x of A x = b, 3 x 3, by elimination with row exchange. */
function solved(matrix, vector) {
  const rows = matrix.map((row, i) => [...row, vector[i]]);
  for (let i = 0; i < 3; i++) {
    let pivot = i;
    for (let j = i + 1; j < 3; j++) if (Math.abs(rows[j][i]) > Math.abs(rows[pivot][i])) pivot = j;
    [rows[i], rows[pivot]] = [rows[pivot], rows[i]];
    for (let j = i + 1; j < 3; j++) {
      const share = rows[j][i] / rows[i][i];
      for (let k = i; k < 4; k++) rows[j][k] -= share * rows[i][k];
    }
  }
  const x = [0, 0, 0];
  for (let i = 2; i >= 0; i--) {
    x[i] = rows[i][3];
    for (let j = i + 1; j < 3; j++) x[i] -= rows[i][j] * x[j];
    x[i] /= rows[i][i];
  }
  return x;
}
