package leaprig;

/** What the arm can do, and what may be asked of it. Joint ranges: data sheet of the LBR iiwa, both models. */
final class Limits {
    private static final double[] RANGE = {170, 120, 170, 120, 170, 120, 175};
    static final double MASS = 14;
    static final double CENTRE_MM = 500;
    static final double TOOL_MM = 1000;

    private Limits() { }

    static double range(int joint) { return Math.toRadians(RANGE[joint]); }

    static double clip(int joint, double angle) {
        return Math.max(-range(joint), Math.min(range(joint), angle));
    }

    /** Returns the first joint whose angle is outside its range or not a number, counted from 0; -1 if none is. */
    static int outside(double[] joints) {
        for (int i = 0; i < 7; i++)
            if (!(Math.abs(joints[i]) <= range(i))) return i;
        return -1;
    }

    /** Returns why numbers from..to (exclusive) are refused, null if all are in low..high. */
    static String refuse(String what, double[] values, int from, int to, double low, double high) {
        for (int i = from; i < to; i++)
            if (!(values[i] >= low && values[i] <= high))
                return what + " is " + values[i] + ", but must be " + low + " to " + high;
        return null;
    }
}
