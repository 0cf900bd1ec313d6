package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.geometricModel.Frame;
import kstsim.Kin;
import kstsim.SimRobot;

/** A line, a line in the tool's own axes, or a circle through two poses. */
public abstract class CartesianMotion<T extends CartesianMotion<T>> extends RobotMotion<T> {
    private final Frame via;
    private final Frame end;
    private final double[] offset;
    private double mmPerS = 100;

    CartesianMotion(Frame via, Frame end, double[] offset) {
        this.via = via;
        this.end = end;
        this.offset = offset;
    }

    @SuppressWarnings("unchecked")
    public T setCartVelocity(double v) {
        mmPerS = v;
        return (T) this;
    }

    private static double nearest(double from, double to) {
        return from + Math.IEEEremainder(to - from, 2 * Math.PI);
    }

    @Override
    public IMotionContainer start(double[][] tool) {
        double[][] now = SimRobot.KIN.fk(SimRobot.joints(), tool);
        double[] a = Kin.toXyzAbc(now);
        double[] b;
        if (offset != null) {
            b = a.clone();
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++) b[i] += now[i][k] * offset[k];
        } else {
            b = end.array();
        }
        for (int i = 3; i < 6; i++) b[i] = nearest(a[i], b[i]);
        final double[] goal = b;
        if (via == null) {
            double len = Math.sqrt(sq(b[0] - a[0]) + sq(b[1] - a[1]) + sq(b[2] - a[2]));
            return SimRobot.path(s -> mix(a, goal, s), len, mmPerS, tool, conditions);
        }
        return circle(a, via.array(), goal, tool);
    }

    private static double sq(double v) { return v * v; }

    private static double[] mix(double[] a, double[] b, double s) {
        double[] r = new double[6];
        for (int i = 0; i < 6; i++) r[i] = a[i] + s * (b[i] - a[i]);
        return r;
    }

    private static double dot(double[] a, double[] b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

    private IMotionContainer circle(double[] a, double[] m, double[] b, double[][] tool) {
        double[] u = {m[0] - a[0], m[1] - a[1], m[2] - a[2]};
        double[] v = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), det = uu * vv - uv * uv;
        if (det < 1e-6) throw new IllegalArgumentException("the three points of the circle lie on a line");
        double s = vv * (uu - uv) / (2 * det), t = uu * (vv - uv) / (2 * det);
        double[] c = new double[3], x = new double[3], y = new double[3];
        for (int i = 0; i < 3; i++) c[i] = a[i] + s * u[i] + t * v[i];
        for (int i = 0; i < 3; i++) x[i] = a[i] - c[i];
        double r = Math.sqrt(dot(x, x));
        double[] n = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        double nn = Math.sqrt(dot(n, n));
        for (int i = 0; i < 3; i++) {
            x[i] /= r;
            n[i] /= nn;
        }
        y[0] = n[1] * x[2] - n[2] * x[1];
        y[1] = n[2] * x[0] - n[0] * x[2];
        y[2] = n[0] * x[1] - n[1] * x[0];
        double[] e = {b[0] - c[0], b[1] - c[1], b[2] - c[2]};
        double angle = Math.atan2(dot(e, y), dot(e, x));
        final double sweep = angle <= 0 ? angle + 2 * Math.PI : angle;
        return SimRobot.path(k -> {
            double[] p = mix(a, b, k);
            for (int i = 0; i < 3; i++) p[i] = c[i] + r * (Math.cos(k * sweep) * x[i] + Math.sin(k * sweep) * y[i]);
            return p;
        }, r * sweep, mmPerS, tool, conditions);
    }
}
