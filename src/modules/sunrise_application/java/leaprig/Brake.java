package leaprig;

/** Watches the joints of a servo motion, and brings them to rest at a constant deceleration when it is asked to. */
final class Brake {
    static final double DECELERATION = 10;
    private static final int KEPT = 16;
    private final double[][] seen = new double[KEPT][7];
    private final double[] times = new double[KEPT];
    private int count;
    private final double[] speed = new double[7];
    private final double[] at = new double[7];

    void reset() { count = 0; }

    /** Notes the joints [rad] at a time [s], which grows from call to call. */
    void note(double[] joints, double now) {
        int slot = count % KEPT;
        System.arraycopy(joints, 0, seen[slot], 0, 7);
        times[slot] = now;
        count++;
    }

    /** Begins to brake where the joints are, at their mean speed over the last notes. */
    void begin() {
        int newest = (count + KEPT - 1) % KEPT;
        int oldest = count <= KEPT ? 0 : count % KEPT;
        double span = times[newest] - times[oldest];
        for (int i = 0; i < 7; i++) {
            at[i] = seen[newest][i];
            speed[i] = span > 0 ? (seen[newest][i] - seen[oldest][i]) / span : 0;
        }
    }

    /** Advances by a time [s], all joints in proportion; writes the next destination [rad]. */
    void advance(double seconds, double[] destination) {
        double fastest = 0;
        for (int i = 0; i < 7; i++) fastest = Math.max(fastest, Math.abs(speed[i]));
        double change = DECELERATION * seconds;
        double kept = fastest > change ? 1 - change / fastest : 0;
        double moving = fastest > change ? seconds : fastest / DECELERATION;
        for (int i = 0; i < 7; i++) {
            at[i] = Limits.clip(i, at[i] + 0.5 * (1 + kept) * speed[i] * moving);
            speed[i] *= kept;
            destination[i] = at[i];
        }
    }

    boolean resting() {
        for (int i = 0; i < 7; i++)
            if (speed[i] != 0) return false;
        return true;
    }
}
