package leaprig;

/** A motion to a target, with what breaks it. */
final class Motion {
    enum Kind { JOINTS, LINE, CIRCLE, GUIDE }

    final Kind kind;
    final double[] target;
    final double[] via;
    final double speed;
    /** Triples of joint index, lowest, highest external torque [Nm] of a guarded motion; null: it is none. */
    double[] guard;
    /** Limits of seven external torques [Nm] and of the force at the tool [N], 0: none; null: none at all. */
    double[] contact;

    Motion(Kind kind, double[] target, double[] via, double speed) {
        this.kind = kind;
        this.target = target;
        this.via = via;
        this.speed = speed;
    }

    /** Returns why the controller need not be asked; null if it may be. */
    String refusal() {
        if (kind == Kind.GUIDE) return null;
        if (kind == Kind.JOINTS) {
            int joint = Limits.outside(target);
            if (joint >= 0) return "joint " + (joint + 1) + " is " + target[joint] + " rad, beyond its range";
            if (!(speed > 0 && speed <= 1)) return "the relative speed is " + speed + ", but must be above 0 and at most 1";
        } else if (!(speed > 0 && speed <= 2000)) {
            return "the speed is " + speed + " mm/s, but must be above 0 and at most 2000";
        }
        if (!finite(target) || via != null && !finite(via)) return "the target is not finite";
        if (guard != null)
            for (int i = 0; i < guard.length; i += 3)
                if (!(guard[i] >= 0 && guard[i] < 7)) return "there is no joint " + guard[i];
        return null;
    }

    private static boolean finite(double[] values) {
        for (int i = 0; i < values.length; i++)
            if (Double.isNaN(values[i]) || Double.isInfinite(values[i])) return false;
        return true;
    }

    /** Returns the pose x y z [mm] A B C [rad] moved by a way in the base's axes, or in the tool's own. */
    static double[] moved(double[] pose, double[] way, boolean inTool) {
        double x = way[0], y = way[1], z = way[2];
        double[] to = pose.clone();
        if (inTool) {
            double ca = Math.cos(pose[3]), sa = Math.sin(pose[3]), cb = Math.cos(pose[4]), sb = Math.sin(pose[4]);
            double cc = Math.cos(pose[5]), sc = Math.sin(pose[5]);
            to[0] += ca * cb * x + (ca * sb * sc - sa * cc) * y + (ca * sb * cc + sa * sc) * z;
            to[1] += sa * cb * x + (sa * sb * sc + ca * cc) * y + (sa * sb * cc - ca * sc) * z;
            to[2] += -sb * x + cb * sc * y + cb * cc * z;
        } else {
            to[0] += x;
            to[1] += y;
            to[2] += z;
        }
        return to;
    }
}
