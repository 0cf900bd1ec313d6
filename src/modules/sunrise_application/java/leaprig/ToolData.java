package leaprig;

/** What hangs on the flange: tool and held load together as one mass, and the tool point. */
final class ToolData {
    private double toolMass;
    private double loadMass;
    private double[] toolCentre = new double[3];
    private double[] loadCentre = new double[3];
    double[] frame = new double[6];
    /** Whether somebody stated the tool's mass. */
    boolean known;

    /** Numbers: mass [kg], centre of mass [mm], tool point x y z [mm] A B C [rad], all in the flange's frame. */
    void tool(double[] n) {
        toolMass = n[0];
        toolCentre = new double[] {n[1], n[2], n[3]};
        frame = new double[] {n[4], n[5], n[6], n[7], n[8], n[9]};
        known = n[0] > 0;
    }

    /** Numbers: mass [kg] and centre of mass [mm] in the flange's frame. */
    void load(double[] n) {
        loadMass = n[0];
        loadCentre = new double[] {n[1], n[2], n[3]};
    }

    ToolData copy() {
        ToolData other = new ToolData();
        other.toolMass = toolMass;
        other.loadMass = loadMass;
        return other;
    }

    void forget() {
        toolMass = 0;
        loadMass = 0;
        frame = new double[6];
        known = false;
    }

    double mass() { return toolMass + loadMass; }

    double[] centre() {
        double[] both = new double[3];
        for (int i = 0; i < 3 && mass() > 0; i++)
            both[i] = (toolMass * toolCentre[i] + loadMass * loadCentre[i]) / mass();
        return both;
    }

    /** Returns why the mass that the arm is to carry is refused, or null. */
    String refusal() {
        return mass() <= Limits.MASS ? null : "tool and load weigh " + mass() + " kg, more than " + Limits.MASS;
    }
}
