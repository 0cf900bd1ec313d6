package leaprig;

/** The stored goals, in the units of the wire; written by the reader of the wire, read by the servo. */
final class Goals {
    private final double[] joints = new double[7];
    private final double[] pose = new double[6];
    private final double[] speed = new double[7];
    private double speedAt = Double.NEGATIVE_INFINITY;

    synchronized void reset(double[] presentJoints, double[] presentPose, double now) {
        System.arraycopy(presentJoints, 0, joints, 0, 7);
        System.arraycopy(presentPose, 0, pose, 0, 6);
        java.util.Arrays.fill(speed, 0);
        speedAt = now;
    }

    synchronized void setJoints(double[] values, int count) {
        System.arraycopy(values, 0, joints, 0, Math.min(count, 7));
    }

    synchronized void setPose(double[] values, int count) {
        System.arraycopy(values, 0, pose, 0, Math.min(count, 6));
    }

    synchronized void setSpeed(double[] values, int count, double now) {
        System.arraycopy(values, 0, speed, 0, Math.min(count, 7));
        speedAt = now;
    }

    synchronized void joints(double[] into) { System.arraycopy(joints, 0, into, 0, 7); }

    synchronized void pose(double[] into) { System.arraycopy(pose, 0, into, 0, 6); }

    /** Writes the wanted speeds, zero if they are older than a time [s]. */
    synchronized void speed(double[] into, double since) {
        if (speedAt < since) java.util.Arrays.fill(into, 0);
        else System.arraycopy(speed, 0, into, 0, 7);
    }
}
